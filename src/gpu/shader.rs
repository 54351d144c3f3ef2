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

/// The shader's text with its includes appended after it, so that its own line numbers stay.
///
/// # Errors
/// [`Error::Shader`] for an include that does not exist.
fn expand(shader: &Shader) -> Result<String> {
    let mut text = shader.source.to_owned();
    for (line, content) in shader.source.lines().enumerate() {
        let Some(name) = content.strip_prefix("// include: ") else { continue };
        let Some((_, shared)) = SHARED.iter().find(|(n, _)| *n == name.trim()) else {
            return Err(shader.error(line as u32 + 1, format!("no shared file `{name}`")));
        };
        text.push('\n');
        text.push_str(shared);
    }
    Ok(text)
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
    let text = expand(shader)?;
    let module = naga::front::wgsl::parse_str(&text).map_err(|e| {
        let line = e.location(&text).map_or(0, |l| l.line_number);
        shader.error(line, e.emit_to_string(&text))
    })?;
    let info = Validator::new(ValidationFlags::all(), Capabilities::all())
        .validate(&module)
        .map_err(|e| {
            let line = e.location(&text).map_or(0, |l| l.line_number);
            shader.error(line, e.emit_to_string(&text))
        })?;
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
    Ok(Reflection { text, entries, params })
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
