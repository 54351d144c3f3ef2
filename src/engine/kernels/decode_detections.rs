//! Detections from the RoI head.

use crate::engine::kernels::{Caps, Dispatch, Grid, Io, Kernel, Recording, Work};
use crate::engine::ops::DecodeDetections;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::Result;

shader_params! {
    struct Params {
        rois: u32,
        classes: u32,
        /// Bit c: class c is wanted.
        class_mask: u32,
        picture_width: f32,
        picture_height: f32,
        weight_x: f32,
        weight_y: f32,
        weight_width: f32,
        weight_height: f32,
        /// One by the temperature.
        scale: f32,
    }
}

static SHADER: Shader = Shader {
    stem: "decode_detections",
    source: include_str!("../../../wgsl/decode_detections.wgsl"),
    params: PARAMS,
};

/// The definition.
#[derive(Debug)]
pub(super) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "decode_detections/planar"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(&SHADER, Variant::default())]
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &DecodeDetections = work.op()?;
        let [rois, classes] = [0, 1].map(|i| recording.dims(inputs[2])[i]);
        let [weight_x, weight_y, weight_width, weight_height] = op.weights;
        let params = Params {
            rois: rois as u32,
            classes: classes as u32,
            class_mask: op.class_mask,
            picture_width: op.width as f32,
            picture_height: op.height as f32,
            weight_x,
            weight_y,
            weight_width,
            weight_height,
            scale: 1.0 / op.temperature,
        };
        let bindings = [
            ("rois", inputs[0]),
            ("deltas", inputs[1]),
            ("logits", inputs[2]),
            ("input_count", inputs[3]),
            ("boxes", outputs[0]),
            ("scores", outputs[1]),
            ("margins", outputs[2]),
            ("classes", outputs[3]),
        ];
        let grid = Grid::linear(rois * (classes - 1), 64);
        recording.dispatch(Dispatch::new(&SHADER, "decode", &params, &bindings, grid));
        let bindings = [("input_count", inputs[3]), ("output_count", outputs[4])];
        let grid = Grid::Workgroups([1, 1, 1]);
        recording.dispatch(Dispatch::new(&SHADER, "count", &params, &bindings, grid));
        Ok(())
    }
}
