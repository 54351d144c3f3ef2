//! The detector and the kernels' check for JavaScript: what the package's worker stands on.
//!
//! | file | what it holds |
//! |---|---|
//! | `error` | the library's errors as JavaScript's |
//! | `options` | a detector's options, as the library's configuration |
//! | `found` | what a detector finds, as JSON |
//! | `checks` | the kernels on a GPU, held to their references |

mod checks;
mod error;
mod found;
mod options;

use std::sync::Arc;

use smr_gpu::{Frame, GpuDetector, PixelFormat};
use wasm_bindgen::prelude::*;

use crate::error::{Thrown, thrown};

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_namespace = console, js_name = error)]
    fn console_error(message: &str);
}

/// A panic ends the module: where it was, the console says.
#[wasm_bindgen(start)]
fn start() {
    std::panic::set_hook(Box::new(|panic| console_error(&panic.to_string())));
}

/// Finds snaps in pictures.
#[wasm_bindgen]
pub struct Detector(GpuDetector);

#[wasm_bindgen]
impl Detector {
    /// Opens the GPU, compiles the shaders and uploads the weights, a safetensors file's bytes that `name` stands
    /// for in messages. `options` are JSON.
    pub async fn load(
        name: String,
        weights: js_sys::Uint8Array,
        options: String,
    ) -> Result<Self, Thrown> {
        let config = options::config(&name, bytes(&weights), &options).map_err(thrown)?;
        GpuDetector::new_async(config).await.map(Self).map_err(thrown)
    }

    /// What it finds in a picture of so many pixels in red, green, blue and alpha, as JSON.
    pub async fn detect(&self, width: u32, height: u32, rgba: Vec<u8>) -> Result<String, Thrown> {
        let frame = Frame::new(rgba, width, height, PixelFormat::Rgba8);
        let found = self.0.detect_async(frame).await.map_err(thrown)?;
        found::json(&found, &self.0).map_err(thrown)
    }

    /// The classes' names.
    #[wasm_bindgen(getter)]
    pub fn classes(&self) -> Vec<String> {
        self.0.model().classes.clone()
    }

    /// What went otherwise than the options say.
    #[wasm_bindgen(getter)]
    pub fn remarks(&self) -> Vec<String> {
        self.0.remarks()
    }
}

/// The bytes, copied once.
fn bytes(given: &js_sys::Uint8Array) -> Arc<[u8]> {
    let mut bytes: Arc<[u8]> = (0..given.length()).map(|_| 0).collect();
    if let Some(bytes) = Arc::get_mut(&mut bytes) {
        given.copy_to(bytes);
    }
    bytes
}
