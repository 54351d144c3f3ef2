//! Where something touches the gel.

use crate::engine::kernels::{Caps, Dispatch, Grid, Io, Kernel, Recording, Work};
use crate::engine::ops::ContactMap;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::shape::TensorSpec;
use crate::error::Result;

shader_params! {
    struct Params {
        height: u32,
        width: u32,
        /// Tiles in a row, and all of them.
        columns: u32,
        tiles: u32,
        least: f32,
        most: f32,
        clipped: f32,
        reach: u32,
        factor: f32,
        /// 1 where there is a reference frame.
        referenced: u32,
        /// Always 0: in a loop's bound it keeps compilers from unrolling.
        zero: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "contact_map",
    source: include_str!("../../../wgsl/contact_map.wgsl"),
    params: PARAMS,
};

/// The definition: what each tile differs by, then all tiles against one limit.
#[derive(Debug)]
pub(super) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "contact_map/planar"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(&SHADER, Variant::default())]
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &ContactMap = work.op()?;
        let [height, width] = [1, 2].map(|i| recording.dims(inputs[0])[i]);
        let [rows, columns] = ContactMap::tiles([height, width]);
        let params = Params {
            height: height as u32,
            width: width as u32,
            columns: columns as u32,
            tiles: (rows * columns) as u32,
            least: op.least,
            most: op.most,
            clipped: op.clipped,
            reach: op.reach,
            factor: op.factor,
            referenced: op.reference.into(),
            zero: 0,
        };
        let tiles = rows * columns;
        let of_tile = recording.scratch("differences", TensorSpec::f32([tiles]));
        let reference = inputs.get(1).copied().unwrap_or(inputs[0]);
        let bindings = [("cells", inputs[0]), ("reference", reference), ("of_tile", of_tile)];
        let grid = Grid::linear(tiles, 64);
        recording.dispatch(Dispatch::new(&SHADER, "differences", &params, &bindings, grid));
        let bindings = [("of_tile", of_tile), ("output", outputs[0])];
        let grid = Grid::Workgroups([1, 1, 1]);
        recording.dispatch(Dispatch::new(&SHADER, "words", &params, &bindings, grid));
        Ok(())
    }
}
