//! Looks at all of one picture as often as a line on stdin asks for it, so that other programs can be timed in
//! turn with this one: `benches/peers` does.
//!
//! ```sh
//! yes | head -5 | cargo run --release --example timed -- auto weights/smrnet.safetensors samples/mixed.png
//! ```
//!
//! Prints a JSON object a line: first the adapter and how long it took to get ready, then for each
//! line read the milliseconds of a run, in all and by stage. A fourth argument names a safetensors
//! file for the network's input, the backbone's maps and the fused one.

use std::collections::HashMap;
use std::error::Error;
use std::ffi::OsStr;
use std::io::{BufRead, Write};
use std::time::Instant;

use safetensors::tensor::{Dtype, TensorView};
use smr_gpu::engine::tensor::Value;
use smr_gpu::verify;
use smr_gpu::{Config, Device, Frame, GpuDetector, Savings, picture};

/// What the fourth argument's file holds, of what the network has.
const TENSORS: [&str; 7] = [
    "input",
    "backbone.cbam3",
    "backbone.cbam4",
    "backbone.cbam5",
    "fusion.fused",
    "rpn.cls",
    "rpn.bbox",
];

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<_> = std::env::args_os().skip(1).collect();
    let [device, weights, file, tensors @ ..] = &args[..] else {
        return Err("expected DEVICE WEIGHTS PICTURE [TENSORS.safetensors]".into());
    };
    let device: Device = device.to_str().ok_or("expected a device")?.parse()?;
    let config = Config { device, savings: Savings::NONE, ..Config::new(weights) };
    let picture = picture::read(file)?;
    let frame = Frame::from(&picture);
    if let [file] = tensors {
        write_tensors(file, config.clone(), &frame)?;
    }
    let start = Instant::now();
    let detector = GpuDetector::new(config)?;
    let ready = start.elapsed().as_secs_f64() * 1e3;
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", serde_json::json!({"adapter": detector.adapter(), "ready_ms": ready}))?;
    out.flush()?;
    for line in std::io::stdin().lock().lines() {
        line?;
        let start = Instant::now();
        let found = detector.detect(&frame)?;
        let ms = start.elapsed().as_secs_f64() * 1e3;
        let line = serde_json::json!({
            "ms": ms, "stages": found.stages, "detections": found.detections.len()
        });
        writeln!(out, "{line}")?;
        out.flush()?;
    }
    Ok(())
}

/// Writes [`TENSORS`] from a run of their own: keeping them costs memory.
fn write_tensors(file: &OsStr, config: Config, frame: &Frame) -> Result<(), Box<dyn Error>> {
    let (_, stages) =
        verify::stages(&GpuDetector::new(Config { keep_stages: true, ..config })?, frame)?;
    let mut views = HashMap::new();
    for (name, value) in &stages {
        if TENSORS.contains(&name.as_str()) && matches!(value, Value::F32(_)) {
            views.insert(name, TensorView::new(Dtype::F32, value.spec().shape.0, value.bytes())?);
        }
    }
    Ok(std::fs::write(file, safetensors::serialize(views, None)?)?)
}
