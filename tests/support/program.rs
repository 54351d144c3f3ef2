//! The program from outside: running it, what it left, and files for it.
#![allow(dead_code, reason = "not every test crate uses all of it")]

use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use image::RgbImage;
use safetensors::tensor::{Dtype, TensorView};
use serde_json::Value;
use tempfile::TempDir;

pub const WEIGHTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/weights/smrnet.safetensors");

/// What a run of the program left.
pub struct Ran {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl From<Output> for Ran {
    fn from(output: Output) -> Self {
        let text = |bytes| String::from_utf8(bytes).expect("UTF-8");
        Self {
            code: output.status.code(),
            stdout: text(output.stdout),
            stderr: text(output.stderr),
        }
    }
}

impl Ran {
    /// Its stdout as one JSON value a line.
    pub fn json(&self) -> Vec<Value> {
        let parse = |l| serde_json::from_str(l).unwrap_or_else(|e| panic!("{e}: {l}"));
        self.stdout.lines().map(parse).collect()
    }

    /// The program's own messages; a Vulkan layer may add others to stderr.
    pub fn told(&self) -> Vec<&str> {
        self.stderr.lines().filter(|l| l.starts_with("smr-gpu: ")).collect()
    }

    #[track_caller]
    pub fn expect(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "stdout:\n{}stderr:\n{}", self.stdout, self.stderr);
        self
    }

    #[track_caller]
    pub fn tells(self, phrase: &str) -> Self {
        assert!(self.stderr.contains(phrase), "no `{phrase}` in:\n{}", self.stderr);
        self
    }
}

/// The program in a folder, with the repository's weights and none of the user's.
pub fn command(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_smr-gpu"));
    command.current_dir(folder).env("SMR_GPU_WEIGHTS", WEIGHTS).stdin(Stdio::null());
    command.env("XDG_DATA_HOME", folder.join("data"));
    command
}

/// Runs the program in a folder.
pub fn run(folder: &Path, arguments: &[&str]) -> Ran {
    command(folder).args(arguments).output().expect("the program runs").into()
}

pub fn folder() -> TempDir {
    tempfile::tempdir().expect("a folder")
}

/// A picture of a smooth ramp, which no snap resembles.
pub fn ramp(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| image::Rgb([x, y, x / 2 + y / 2].map(|v| v as u8)))
}

pub fn write_tensors(file: &Path, tensors: &[(&str, Dtype, Vec<usize>, Vec<u8>)]) {
    let views = tensors.iter().map(|(name, dtype, shape, bytes)| {
        (*name, TensorView::new(*dtype, shape.clone(), bytes).expect("a tensor"))
    });
    let bytes = safetensors::serialize(views, None).expect("a file");
    fs::write(file, bytes).expect("written");
}

pub fn f32_bytes(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}
