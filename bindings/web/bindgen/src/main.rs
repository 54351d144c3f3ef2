//! Writes the JavaScript around a WebAssembly module, as a module for browsers. Usage: `bindgen MODULE FOLDER`

use std::error::Error;
use std::{env, fs};

use wasm_bindgen_cli_support::Bindgen;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = env::args().skip(1).collect();
    let [module, folder] = &arguments[..] else {
        return Err("expected a WebAssembly module and a folder".into());
    };
    fs::create_dir_all(folder)?;
    Ok(Bindgen::new().input_path(module).web(true)?.typescript(false).generate(folder)?)
}
