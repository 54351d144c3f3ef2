//! The pose of each detection.

use crate::error::Result;
use crate::graph::TensorId;
use crate::kernels::{Caps, Dispatch, Grid, Kernel, Recording, Work};
use crate::ops::DecodePose;
use crate::shader::{Shader, Variant, shader_params};

shader_params! {
    struct Params {
        rows: u32,
        capacity: u32,
        classes: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "decode_pose",
    source: include_str!("../../wgsl/decode_pose.wgsl"),
    params: PARAMS,
};

/// The definition.
#[derive(Debug)]
pub(super) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "decode_pose/planar"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(&SHADER, Variant::default())]
    }

    fn record(
        &self,
        work: &Work,
        recording: &mut Recording,
        inputs: &[TensorId],
        outputs: &[TensorId],
    ) -> Result<()> {
        let op: &DecodePose = work.op()?;
        let rows = recording.dims(inputs[0])[0] as u32;
        let capacity = recording.dims(inputs[1])[0];
        let params = Params { rows, capacity: capacity as u32, classes: op.classes as u32 };
        let bindings = [
            ("rows", inputs[0]),
            ("keep", inputs[1]),
            ("count", inputs[2]),
            ("output", outputs[0]),
        ];
        // Not indirect: so few invocations cost less than the dispatch that would save them.
        let grid = Grid::linear(capacity, 64);
        recording.dispatch(Dispatch::new(&SHADER, "main", &params, &bindings, grid));
        Ok(())
    }
}
