//! Shader sources, naga's reflection of them, and the check that Rust and WGSL agree.

use naga::valid::{Capabilities, ValidationFlags, Validator};

use crate::engine::precision::Precision;
use crate::error::{Error, Result};

/// What a shader reads from its uniform: a number, or what is made of such.
pub(crate) trait Uniform {
    /// The type's name in WGSL.
    fn name() -> String;

    /// Adds the declarations of the structs that it is made of, each once.
    fn declare(_structs: &mut Vec<String>) {}
}

impl Uniform for u32 {
    fn name() -> String {
        "u32".into()
    }
}

impl Uniform for f32 {
    fn name() -> String {
        "f32".into()
    }
}

impl<T: Uniform, const N: usize> Uniform for [T; N] {
    fn name() -> String {
        format!("array<{}, {N}>", T::name())
    }

    fn declare(structs: &mut Vec<String>) {
        T::declare(structs);
    }
}

/// A shader's `Params`, which Rust declares for both.
#[derive(Clone, Copy, Debug)]
pub struct ParamLayout {
    /// Size of the struct in bytes.
    pub size: usize,
    /// Name and offset of each field.
    pub fields: &'static [(&'static str, usize)],
    /// Adds the declarations in WGSL of the struct and of those that it is made of.
    pub declare: fn(&mut Vec<String>),
}

impl ParamLayout {
    /// Of a shader without parameters.
    pub const NONE: Self = Self { size: 0, fields: &[], declare: |_| {} };
}

/// A shader file under `wgsl/`.
#[derive(Debug)]
pub struct Shader {
    /// The file's name without its ending: `conv2d/direct`.
    pub stem: &'static str,
    /// Text of the file.
    pub source: &'static str,
    /// Its `Params`, which are declared behind the text.
    pub params: ParamLayout,
}

/// How a shader's text is to be read: which lines, and with which constants.
///
/// Lines between `#if NAME` and `#else` or `#endif` count where NAME is among the flags (`#if !NAME`:
/// where it is not). The shader's `Params` are declared behind the text, and each constant as a `u32`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Variant {
    /// Names that hold.
    pub flags: Vec<&'static str>,
    /// Names with their values.
    pub constants: Vec<(&'static str, u32)>,
}

impl Variant {
    /// A variant with these constants.
    pub fn of(constants: &[(&'static str, u32)]) -> Self {
        Self { flags: Vec::new(), constants: constants.to_vec() }
    }

    /// The same with a flag, if it `holds`.
    pub fn with(mut self, flag: &'static str, holds: bool) -> Self {
        self.flags.extend(holds.then_some(flag));
        self
    }
}

impl std::fmt::Display for Variant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let flags = self.flags.iter().map(|flag| (*flag).to_owned());
        let constants = self.constants.iter().map(|(name, value)| format!("{name}={value}"));
        f.write_str(&flags.chain(constants).collect::<Vec<_>>().join(" "))
    }
}

/// Files under `wgsl/shared/`, which a shader takes in with a line `// include: NAME`.
const SHARED: &[(&str, &str)] = &[
    ("index", include_str!("../../wgsl/shared/index.wgsl")),
    ("pixels", include_str!("../../wgsl/shared/pixels.wgsl")),
    ("triangle", include_str!("../../wgsl/shared/triangle.wgsl")),
    ("neighbours", include_str!("../../wgsl/shared/neighbours.wgsl")),
    ("between", include_str!("../../wgsl/shared/between.wgsl")),
    ("bound", include_str!("../../wgsl/shared/bound.wgsl")),
    ("quads", include_str!("../../wgsl/shared/quads.wgsl")),
    ("texels", include_str!("../../wgsl/shared/texels.wgsl")),
    ("input", include_str!("../../wgsl/shared/input.wgsl")),
    ("products", include_str!("../../wgsl/shared/products.wgsl")),
    ("boxes", include_str!("../../wgsl/shared/boxes.wgsl")),
    ("relu", include_str!("../../wgsl/shared/relu.wgsl")),
    ("reduce", include_str!("../../wgsl/shared/reduce.wgsl")),
    ("slices", include_str!("../../wgsl/shared/slices.wgsl")),
    ("over_space", include_str!("../../wgsl/shared/over_space.wgsl")),
    ("gates", include_str!("../../wgsl/shared/gates.wgsl")),
    ("sigmoid", include_str!("../../wgsl/shared/sigmoid.wgsl")),
    ("window", include_str!("../../wgsl/shared/window.wgsl")),
];

/// Another text for one file under `wgsl/`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Replacement {
    /// The file's name without its ending: `conv2d/planar`, `shared/reduce`.
    pub file: String,
    /// Its text.
    pub text: String,
}

impl Replacement {
    /// The text of `file`: the last of these that is meant, else its own.
    fn text<'a>(replacements: &'a [Self], file: &str, own: &'a str) -> &'a str {
        replacements.iter().rfind(|r| r.file == file).map_or(own, |r| &r.text)
    }
}

/// Declares a struct for Rust and for shaders.
macro_rules! shader_struct {
    ($(#[$attribute:meta])* $vis:vis struct $name:ident {
        $($(#[$field_attribute:meta])* $field_vis:vis $field:ident : $type:ty),+ $(,)?
    }) => {
        $(#[$attribute])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
        $vis struct $name { $($(#[$field_attribute])* $field_vis $field: $type),+ }

        impl $crate::engine::shader::Uniform for $name {
            fn name() -> String {
                stringify!($name).into()
            }

            fn declare(structs: &mut Vec<String>) {
                $(<$type as $crate::engine::shader::Uniform>::declare(structs);)+
                let fields = [$((
                    stringify!($field),
                    <$type as $crate::engine::shader::Uniform>::name(),
                )),+];
                let fields = fields.map(|(field, name)| format!("    {field}: {name},\n"));
                let own = format!("struct {} {{\n{}}}\n", Self::name(), fields.concat());
                if !structs.contains(&own) {
                    structs.push(own);
                }
            }
        }
    };
}
pub(crate) use shader_struct;

/// Declares `Params`, a shader's uniform, for Rust and for the shader, and its [`ParamLayout`].
macro_rules! shader_params {
    (struct Params { $($(#[$attribute:meta])* $field:ident : $type:ty),+ $(,)? }) => {
        $crate::engine::shader::shader_struct! {
            /// What the shader reads from its uniform.
            struct Params { $($(#[$attribute])* $field: $type),+ }
        }

        const PARAMS: $crate::engine::shader::ParamLayout = $crate::engine::shader::ParamLayout {
            size: std::mem::size_of::<Params>(),
            fields: &[$((stringify!($field), std::mem::offset_of!(Params, $field))),+],
            declare: <Params as $crate::engine::shader::Uniform>::declare,
        };
    };
}
pub(crate) use shader_params;

/// What an entry point binds.
#[derive(Clone, Debug)]
pub struct EntryReflection {
    /// Entry point's name.
    pub name: String,
    /// Bindings of group 0 that it uses: name, binding number, kind.
    pub bindings: Vec<(String, u32, BindingKind)>,
    /// Bytes of workgroup memory that it uses.
    pub workgroup_bytes: u32,
    /// Invocations a workgroup.
    pub workgroup_size: [u32; 3],
    /// Whether it reads how many workgroups there are. Of an indirect dispatch not every backend knows.
    pub reads_grid: bool,
}

/// How a shader accesses a binding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BindingKind {
    /// The uniform `params`.
    Uniform,
    /// Storage that is only read.
    Read,
    /// Storage that is written.
    ReadWrite,
    /// A storage texture of rgba32float or rgba16float that is only read.
    Texture(Precision),
}

/// naga's view of a shader.
#[derive(Clone, Debug)]
pub struct Reflection {
    /// The text after includes.
    pub text: String,
    /// Every entry point.
    pub entries: Vec<EntryReflection>,
    /// The text, parsed.
    pub module: naga::Module,
}

/// A shader's text followed by the files that it includes.
struct Expanded {
    text: String,
    /// Each file, and how many lines of `text` come before it.
    files: Vec<(String, usize)>,
}

/// Keeps the lines of `text` whose conditions hold, and leaves the others empty, so that lines keep
/// their numbers.
///
/// # Errors
/// The number of a line that does not fit, with what is wrong about it.
fn select(text: &str, flags: &[&str]) -> std::result::Result<String, (u32, String)> {
    let mut kept = String::with_capacity(text.len());
    // For each open condition, whether its lines count.
    let mut open: Vec<bool> = Vec::new();
    for (number, line) in (1..).zip(text.lines()) {
        let wrong = |what: &str| (number, format!("`{}` {what}", line.trim()));
        match line.trim().split_once(' ').unwrap_or((line.trim(), "")) {
            ("#if", flag) => open.push(match flag.trim().strip_prefix('!') {
                Some(flag) => !flags.contains(&flag),
                None => flags.contains(&flag.trim()),
            }),
            ("#else", _) => match open.last_mut() {
                Some(holds) => *holds = !*holds,
                None => return Err(wrong("without `#if`")),
            },
            ("#endif", _) => drop(open.pop().ok_or_else(|| wrong("without `#if`"))?),
            (word, _) if word.starts_with('#') => return Err(wrong("is no condition")),
            _ if open.iter().all(|holds| *holds) => kept.push_str(line),
            _ => {}
        }
        kept.push('\n');
    }
    match open.is_empty() {
        true => Ok(kept),
        false => Err((text.lines().count() as u32, "`#if` without `#endif`".into())),
    }
}

impl Expanded {
    /// # Errors
    /// [`Error::Shader`] for an include that does not exist, or a condition that does not end.
    fn new(shader: &Shader, variant: &Variant, replacements: &[Replacement]) -> Result<Self> {
        let own = Replacement::text(replacements, shader.stem, shader.source);
        let mut whole = Self { text: String::new(), files: Vec::new() };
        whole.push(&format!("{}.wgsl", shader.stem), own, variant)?;
        for (line, content) in whole.text.clone().lines().enumerate() {
            let Some(name) = content.strip_prefix("// include: ") else { continue };
            let Some((name, shared)) = SHARED.iter().find(|(n, _)| *n == name.trim()) else {
                return Err(shader.error(line as u32 + 1, format!("no shared file `{name}`")));
            };
            let file = format!("shared/{name}");
            let text = Replacement::text(replacements, &file, shared);
            whole.text.push('\n');
            whole.push(&format!("{file}.wgsl"), text, variant)?;
        }
        let mut structs = Vec::new();
        (shader.params.declare)(&mut structs);
        structs.iter().for_each(|declared| whole.text.push_str(declared));
        for (name, value) in &variant.constants {
            whole.text.push_str(&format!("const {name}: u32 = {value}u;\n"));
        }
        Ok(whole)
    }

    fn push(&mut self, file: &str, text: &str, variant: &Variant) -> Result<()> {
        self.files.push((file.into(), self.text.lines().count()));
        let text = select(text, &variant.flags);
        let wrong = |(line, message)| Error::Shader { file: file.into(), line, message };
        self.text.push_str(&text.map_err(wrong)?);
        Ok(())
    }

    /// An error at a line of the whole text, under the file and the line that a reader would open.
    fn error(&self, location: Option<naga::SourceLocation>, message: String) -> Error {
        let line = location.map_or(0, |l| l.line_number);
        let before = |(_, first): &&(String, usize)| line as usize > *first;
        let (file, first) = self.files.iter().rfind(before).unwrap_or(&self.files[0]);
        Error::Shader { file: file.clone(), line: line.saturating_sub(*first as u32), message }
    }
}

impl Shader {
    fn error(&self, line: u32, message: impl Into<String>) -> Error {
        Error::Shader { file: format!("{}.wgsl", self.stem), line, message: message.into() }
    }
}

/// Parses and validates `shader` and compares where its `Params` lie with where Rust has them.
///
/// # Errors
/// [`Error::Shader`] with file and line if it does not compile, if it binds outside group 0, or if
/// the two layouts of `Params` differ, as alignment may have it.
pub fn reflect(shader: &Shader, variant: &Variant) -> Result<Reflection> {
    reflect_with(shader, variant, &[])
}

/// [`reflect`] with another text for one of the shader's files.
///
/// # Errors
/// As [`reflect`].
pub fn reflect_replaced(
    shader: &Shader,
    variant: &Variant,
    replacement: &Replacement,
) -> Result<Reflection> {
    reflect_with(shader, variant, std::slice::from_ref(replacement))
}

pub(crate) fn reflect_with(
    shader: &Shader,
    variant: &Variant,
    replacements: &[Replacement],
) -> Result<Reflection> {
    let expanded = Expanded::new(shader, variant, replacements)?;
    let text = &expanded.text;
    let module = naga::front::wgsl::parse_str(text)
        .map_err(|e| expanded.error(e.location(text), e.emit_to_string(text)))?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .map_err(|e| expanded.error(e.location(text), e.emit_to_string(text)))?;
    let mut layouter = naga::proc::Layouter::default();
    layouter.update(module.to_ctx()).map_err(|e| shader.error(0, e.to_string()))?;

    for (_, ty) in module.types.iter() {
        if let (Some("Params"), naga::TypeInner::Struct { members, span }) =
            (ty.name.as_deref(), &ty.inner)
        {
            let fields: Vec<_> =
                members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset)).collect();
            check_params(shader, *span, &fields)?;
        }
    }

    let mut entries = Vec::new();
    for (index, entry) in module.entry_points.iter().enumerate() {
        let usage = info.get_entry_point(index);
        let mut bindings = Vec::new();
        let mut workgroup_bytes = 0;
        for (handle, variable) in module.global_variables.iter() {
            if usage[handle].is_empty() {
                continue;
            }
            if variable.space == naga::AddressSpace::WorkGroup {
                workgroup_bytes += layouter[variable.ty].size;
            }
            let Some(binding) = &variable.binding else { continue };
            let name = variable.name.clone().unwrap_or_default();
            if binding.group != 0 {
                return Err(shader.error(0, format!("`{name}` is not in group 0")));
            }
            let kind = match variable.space {
                naga::AddressSpace::Uniform => BindingKind::Uniform,
                naga::AddressSpace::Storage { access }
                    if access.contains(naga::StorageAccess::STORE) =>
                {
                    BindingKind::ReadWrite
                }
                naga::AddressSpace::Handle => {
                    let format = texture_format(&module.types[variable.ty].inner);
                    let unknown = || shader.error(0, format!("`{name}` has another format"));
                    BindingKind::Texture(format.ok_or_else(unknown)?)
                }
                _ => BindingKind::Read,
            };
            bindings.push((name, binding.binding, kind));
        }
        entries.push(EntryReflection {
            name: entry.name.clone(),
            bindings,
            workgroup_bytes,
            workgroup_size: entry.workgroup_size,
            reads_grid: reads_grid(&module, entry),
        });
    }
    Ok(Reflection { text: expanded.text, entries, module })
}

fn reads_grid(module: &naga::Module, entry: &naga::EntryPoint) -> bool {
    let is_grid = |binding: &Option<naga::Binding>| {
        matches!(binding, Some(naga::Binding::BuiltIn(naga::BuiltIn::NumWorkGroups)))
    };
    entry.function.arguments.iter().any(|argument| match &module.types[argument.ty].inner {
        naga::TypeInner::Struct { members, .. } => members.iter().any(|m| is_grid(&m.binding)),
        _ => is_grid(&argument.binding),
    })
}

/// How the texels of a storage texture are stored; `None` for what the crate has none of.
fn texture_format(ty: &naga::TypeInner) -> Option<Precision> {
    match ty {
        naga::TypeInner::Image {
            class: naga::ImageClass::Storage { format, access: naga::StorageAccess::LOAD },
            ..
        } => match format {
            naga::StorageFormat::Rgba32Float => Some(Precision::F32),
            naga::StorageFormat::Rgba16Float => Some(Precision::F16),
            _ => None,
        },
        _ => None,
    }
}

fn check_params(shader: &Shader, span: u32, fields: &[(String, u32)]) -> Result<()> {
    let rust: Vec<(String, u32)> =
        shader.params.fields.iter().map(|(n, o)| ((*n).to_owned(), *o as u32)).collect();
    if rust != fields || shader.params.size as u32 != span {
        return Err(shader.error(
            0,
            format!(
                "Params differ: Rust has {rust:?} in {} bytes, WGSL has {fields:?} in {span} bytes",
                shader.params.size
            ),
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn own(source: &'static str) -> Shader {
        Shader { stem: "own", source, params: ParamLayout::NONE }
    }

    fn place(source: &'static str) -> (String, u32) {
        match reflect(&own(source), &Variant::default()) {
            Err(Error::Shader { file, line, .. }) => (file, line),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn an_error_names_the_file_and_line_that_it_is_in() {
        let own = "// include: index\n\nfn broken() -> u32 { return missing; }\n";
        assert_eq!(place(own), ("own.wgsl".into(), 3));
        assert_eq!(place("\n// include: none\n"), ("own.wgsl".into(), 2));
    }

    #[test]
    fn a_line_of_the_expanded_text_is_a_line_of_one_file() {
        let source = "// include: relu\n// include: index\n";
        let text = Expanded::new(&own(source), &Variant::default(), &[]).expect("includes");
        for (number, content) in text.text.lines().enumerate() {
            let at = naga::SourceLocation {
                line_number: number as u32 + 1,
                line_position: 1,
                offset: 0,
                length: 0,
            };
            let Error::Shader { file, line, .. } = text.error(Some(at), String::new()) else {
                panic!("another error");
            };
            let whole = match file.strip_prefix("shared/").and_then(|f| f.strip_suffix(".wgsl")) {
                Some(name) => SHARED.iter().find(|(n, _)| *n == name).expect("a shared file").1,
                None => source,
            };
            // An empty line parts the files.
            assert_eq!(
                whole.lines().nth(line as usize - 1).unwrap_or(""),
                content,
                "{file}:{line}"
            );
        }
    }

    #[test]
    fn conditions_choose_lines_and_keep_their_numbers() {
        let text = "a\n#if X\nb\n#if !Y\nc\n#endif\n#else\nd\n#endif\n";
        let lines = |flags: &[&str]| -> Vec<(usize, String)> {
            let kept = select(text, flags).expect("conditions that end");
            let lines = kept.lines().map(str::to_owned).enumerate();
            lines.filter(|(_, line)| !line.is_empty()).collect()
        };
        let at = |lines: &[(usize, &str)]| -> Vec<(usize, String)> {
            lines.iter().map(|(n, l)| (*n, (*l).to_owned())).collect()
        };
        assert_eq!(lines(&[]), at(&[(0, "a"), (7, "d")]));
        assert_eq!(lines(&["X"]), at(&[(0, "a"), (2, "b"), (4, "c")]));
        assert_eq!(lines(&["X", "Y"]), at(&[(0, "a"), (2, "b")]));
        for (text, line) in [("#if X\n", 1), ("\n#endif\n", 2), ("#else\n", 1), ("#ifdef X\n", 1)] {
            assert_eq!(select(text, &[]).expect_err("a wrong condition").0, line, "{text}");
        }
    }

    #[test]
    fn who_reads_the_grid_is_known() {
        let source = "struct In { @builtin(num_workgroups) grid: vec3<u32> }
            @compute @workgroup_size(1) fn a(@builtin(num_workgroups) n: vec3<u32>) {}
            @compute @workgroup_size(1) fn b(in: In) {}
            @compute @workgroup_size(1) fn c(@builtin(workgroup_id) id: vec3<u32>) {}";
        let entries = reflect(&own(source), &Variant::default()).expect("a shader").entries;
        let reads: Vec<bool> = entries.iter().map(|entry| entry.reads_grid).collect();
        assert_eq!(reads, [true, true, false]);
    }

    #[test]
    fn constants_are_declared() {
        let source = "@compute @workgroup_size(LANES) fn main() {}";
        let reflection = reflect(&own(source), &Variant::of(&[("LANES", 8)])).expect("a shader");
        assert_eq!(reflection.entries[0].workgroup_size, [8, 1, 1]);
    }
}
