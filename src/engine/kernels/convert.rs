//! From one layout of a map to another.

use crate::engine::graph::TensorId;
use crate::engine::kernels::{Caps, Dispatch, Grid, Layout, Quads, Recording, texels};
use crate::engine::precision::Precision;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::error::{Error, Result};

shader_params! {
    struct Params {
        map: Quads,
        /// Elements of a planar picture.
        stride: u32,
    }
}

static SHADER: Shader =
    Shader { stem: "convert", source: include_str!("../../../wgsl/convert.wgsl"), params: PARAMS };

/// Invocations of a workgroup.
const LANES: u32 = 64;

/// The shader for maps that are stored so.
fn variant(precision: Precision) -> Variant {
    texels(Variant::default(), precision, precision)
}

/// A conversion that a lowering puts between two kernels; no operation of the network.
#[derive(Debug)]
pub(crate) struct Convert;

impl Convert {
    /// Its shader.
    pub fn shaders(_caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        [Precision::F32, Precision::F16].map(|p| (&SHADER, variant(p))).into()
    }

    /// Appends what brings `from` to the layout of `to`, a tensor of the same shape.
    ///
    /// # Errors
    /// [`Error::Tensor`] for what is no map or too large, and for layouts between which there is no
    /// single step.
    pub fn record(recording: &mut Recording, from: TensorId, to: TensorId) -> Result<()> {
        let map = recording.quads(to)?;
        let (entry, planar, quads) = match (recording.info(from).layout, recording.info(to).layout)
        {
            (Layout::Quads, Layout::Texture) => {
                recording.copy(from, to);
                return Ok(());
            }
            (Layout::Planar, Layout::Quads) => ("to_quads", from, to),
            (Layout::Quads, Layout::Planar) => ("to_planar", to, from),
            (from, to) => {
                return Err(Error::tensor(
                    "convert",
                    "map",
                    "one step",
                    format!("{from:?} to {to:?}"),
                ));
            }
        };
        let params = Params { map, stride: recording.stride(planar) };
        let rows = map.quads * map.height;
        let names = match entry {
            "to_quads" => ["planar", "quads"],
            _ => ["planar_out", "quads_in"],
        };
        let bindings = [(names[0], planar), (names[1], quads)];
        let grid = Grid::Workgroups([map.width.div_ceil(LANES), rows, recording.batch()]);
        let variant = variant(recording.info(quads).precision);
        recording
            .dispatch(Dispatch::new(&SHADER, entry, &params, &bindings, grid).variant(variant));
        Ok(())
    }
}
