//! Every shader in every variant, for adapters of all kinds.

use smr_gpu::engine::kernels::{self, Caps};
use smr_gpu::engine::shader::{Shader, Variant};

pub fn all() -> Vec<(&'static Shader, Variant)> {
    let mut found: Vec<(&'static Shader, Variant)> = Vec::new();
    for sizes in Caps::SUBGROUPS {
        for (shader, variant) in kernels::shaders(&Caps::default().with_subgroups(sizes)) {
            if !found.iter().any(|(s, v)| s.stem == shader.stem && *v == variant) {
                found.push((shader, variant));
            }
        }
    }
    found
}

/// Whether a text, without its comments, does anything by subgroup.
pub fn uses_subgroups(text: &str) -> bool {
    let code = |line: &str| line.split("//").next().is_some_and(|code| code.contains("subgroup"));
    text.lines().any(code)
}
