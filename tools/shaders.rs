//! Writes every shader in every variant, with its includes, into a folder: for other compilers.
//!
//! ```sh
//! cargo run --release --example shaders -- FOLDER
//! ```
//!
//! Shaders that use subgroups begin with `enable subgroups;`, which WGSL demands and naga refuses. It
//! stands before the first line, so that lines keep their numbers.

#[path = "../tests/support/shaders.rs"]
mod shaders;

use std::error::Error;
use std::path::PathBuf;

use smr_gpu::engine::shader::reflect;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args_os().nth(1).ok_or("expected a folder's name")?);
    std::fs::create_dir_all(&folder)?;
    let all = shaders::all();
    for (shader, variant) in &all {
        let text = reflect(shader, variant)?.text;
        let enable = if shaders::uses_subgroups(&text) { "enable subgroups; " } else { "" };
        let name = format!("{} {variant}", shader.stem).trim().replace('/', ".").replace(' ', ",");
        std::fs::write(folder.join(name + ".wgsl"), format!("{enable}{text}"))?;
    }
    println!("{} shaders in {}", all.len(), folder.display());
    Ok(())
}
