//! Shader sources, naga's reflection of them, and the check that Rust and WGSL agree.

use naga::valid::{Capabilities, ValidationFlags, Validator};

use crate::error::{Error, Result};

/// Field names and offsets of a Rust struct that mirrors a shader's `Params`.
#[derive(Clone, Copy, Debug)]
pub struct ParamLayout {
    /// Size of the struct in bytes.
    pub size: usize,
    /// Name and offset of each field.
    pub fields: &'static [(&'static str, usize)],
}

/// A shader file under `wgsl/`.
#[derive(Debug)]
pub struct Shader {
    /// Stem of the file, which is the operation's name.
    pub stem: &'static str,
    /// Text of the file.
    pub source: &'static str,
    /// Layout of its `Params`, to be compared with naga's.
    pub params: ParamLayout,
}

/// Files under `wgsl/shared/`, which a shader takes in with a line `// include: NAME`.
const SHARED: &[(&str, &str)] = &[
    ("index", include_str!("../../wgsl/shared/index.wgsl")),
    ("boxes", include_str!("../../wgsl/shared/boxes.wgsl")),
    ("relu", include_str!("../../wgsl/shared/relu.wgsl")),
    ("reduce", include_str!("../../wgsl/shared/reduce.wgsl")),
    ("sigmoid", include_str!("../../wgsl/shared/sigmoid.wgsl")),
];

/// Another text for one file under `wgsl/`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Replacement {
    /// The file's name without its ending: `conv2d`, `shared/reduce`.
    pub file: String,
    /// Its text.
    pub text: String,
}

impl Replacement {
    /// The text of `file`: this one if it is meant, else its own.
    fn text<'a>(replacement: Option<&'a Self>, file: &str, own: &'a str) -> &'a str {
        replacement.filter(|r| r.file == file).map_or(own, |r| &r.text)
    }
}

/// Declares `Params`, the Rust mirror of a shader's uniform, and its [`ParamLayout`].
macro_rules! shader_params {
    (struct Params { $($field:ident : $type:ty),+ $(,)? }) => {
        /// Mirror of the shader's `Params`.
        #[repr(C)]
        #[derive(Clone, Copy, Debug, bytemuck::Pod, bytemuck::Zeroable)]
        struct Params { $($field: $type),+ }

        const PARAMS: $crate::gpu::ParamLayout = $crate::gpu::ParamLayout {
            size: std::mem::size_of::<Params>(),
            fields: &[$((stringify!($field), std::mem::offset_of!(Params, $field))),+],
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
}

/// naga's view of a shader.
#[derive(Clone, Debug)]
pub struct Reflection {
    /// The text after includes.
    pub text: String,
    /// Every entry point.
    pub entries: Vec<EntryReflection>,
    /// Size of `Params` and offset of each member, if the shader has one.
    pub params: Option<(u32, Vec<(String, u32)>)>,
}

/// A shader's text followed by the files that it includes.
struct Expanded {
    text: String,
    /// Each file, and how many lines of `text` come before it.
    files: Vec<(String, usize)>,
}

impl Expanded {
    /// # Errors
    /// [`Error::Shader`] for an include that does not exist.
    fn new(shader: &Shader, replacement: Option<&Replacement>) -> Result<Self> {
        let own = Replacement::text(replacement, shader.stem, shader.source);
        let mut text = own.to_owned();
        let mut files = vec![(format!("{}.wgsl", shader.stem), 0)];
        for (line, content) in own.lines().enumerate() {
            let Some(name) = content.strip_prefix("// include: ") else { continue };
            let Some((name, shared)) = SHARED.iter().find(|(n, _)| *n == name.trim()) else {
                return Err(shader.error(line as u32 + 1, format!("no shared file `{name}`")));
            };
            text.push('\n');
            files.push((format!("shared/{name}.wgsl"), text.lines().count()));
            text.push_str(Replacement::text(replacement, &format!("shared/{name}"), shared));
        }
        Ok(Self { text, files })
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

/// Parses and validates `shader` and compares its `Params` with Rust's mirror.
///
/// # Errors
/// [`Error::Shader`] with file and line if it does not compile, if it binds outside group 0, or if
/// the two layouts of `Params` differ.
pub fn reflect(shader: &Shader) -> Result<Reflection> {
    reflect_with(shader, None)
}

/// [`reflect`] with another text for one of the shader's files.
///
/// # Errors
/// As [`reflect`].
pub fn reflect_replaced(shader: &Shader, replacement: &Replacement) -> Result<Reflection> {
    reflect_with(shader, Some(replacement))
}

pub(super) fn reflect_with(
    shader: &Shader,
    replacement: Option<&Replacement>,
) -> Result<Reflection> {
    let expanded = Expanded::new(shader, replacement)?;
    let text = &expanded.text;
    let module = naga::front::wgsl::parse_str(text)
        .map_err(|e| expanded.error(e.location(text), e.emit_to_string(text)))?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .map_err(|e| expanded.error(e.location(text), e.emit_to_string(text)))?;
    let mut layouter = naga::proc::Layouter::default();
    layouter.update(module.to_ctx()).map_err(|e| shader.error(0, e.to_string()))?;

    let mut params = None;
    for (_, ty) in module.types.iter() {
        if let (Some("Params"), naga::TypeInner::Struct { members, span }) =
            (ty.name.as_deref(), &ty.inner)
        {
            let fields: Vec<_> =
                members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset)).collect();
            params = Some((*span, fields));
        }
    }
    if let Some((span, fields)) = &params {
        check_params(shader, *span, fields)?;
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
                _ => BindingKind::Read,
            };
            bindings.push((name, binding.binding, kind));
        }
        entries.push(EntryReflection {
            name: entry.name.clone(),
            bindings,
            workgroup_bytes,
            workgroup_size: entry.workgroup_size,
        });
    }
    Ok(Reflection { text: expanded.text, entries, params })
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

    const NONE: ParamLayout = ParamLayout { size: 0, fields: &[] };

    fn place(source: &'static str) -> (String, u32) {
        match reflect(&Shader { stem: "own", source, params: NONE }) {
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
        let text =
            Expanded::new(&Shader { stem: "own", source, params: NONE }, None).expect("includes");
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
}
