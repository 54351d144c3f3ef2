//! Softmax over rows.

use crate::error::Result;
use crate::graph::TensorId;
use crate::kernels::count::count_tensor;
use crate::kernels::count::row_grid;
use crate::kernels::{Caps, Dispatch, Kernel, Recording, Work};
use crate::ops::Softmax;
use crate::shader::{Shader, Variant, shader_params};

shader_params! {
    struct Params {
        rows: u32,
        columns: u32,
        scale: f32,
        zero: u32,
    }
}

static SHADER: Shader =
    Shader { stem: "softmax", source: include_str!("../../wgsl/softmax.wgsl"), params: PARAMS };

/// Invocations of the workgroup that computes a row.
const LANES: u32 = 64;

/// The definition, on planar maps.
#[derive(Debug)]
pub(super) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "softmax/planar"
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
        let op: &Softmax = work.op()?;
        let [rows, columns] = [0, 1].map(|i| recording.dims(inputs[0])[i]);
        let given = inputs.get(1).copied();
        let count = count_tensor(recording, given, rows);
        let grid = row_grid(recording, given, rows, LANES as usize, LANES)?;
        let bindings = [("input", inputs[0]), ("count", count), ("output", outputs[0])];
        let params = Params {
            rows: rows as u32,
            columns: columns as u32,
            scale: 1.0 / op.temperature,
            zero: 0,
        };
        recording.dispatch(Dispatch::new(&SHADER, "main", &params, &bindings, grid));
        Ok(())
    }
}
