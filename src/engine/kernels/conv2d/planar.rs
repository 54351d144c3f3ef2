//! On planar maps.

use super::padded_bias;
use crate::engine::kernels::{Caps, Dispatch, Grid, Io, Kernel, MAX_WORKGROUPS, Recording, Work};
use crate::engine::ops::conv2d::CHANNELS;
use crate::engine::ops::{Conv2d, Op};
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Tensor;
use crate::error::{Error, Result};

shader_params! {
    struct Params {
        in_channels: u32,
        in_height: u32,
        in_width: u32,
        out_channels: u32,
        out_height: u32,
        out_width: u32,
        kernel_height: u32,
        kernel_width: u32,
        stride: u32,
        padding: u32,
        dilation: u32,
        has_residual: u32,
        relu: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "conv2d/planar",
    source: include_str!("../../../../wgsl/conv2d/planar.wgsl"),
    params: PARAMS,
};

/// Output pixels that one workgroup computes.
const PIXELS: usize = 64;

/// The definition, on planar maps.
#[derive(Debug)]
pub(in crate::engine::kernels) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "conv2d/planar"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(&SHADER, Variant::default())]
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &Conv2d = work.op()?;
        let (&input, &weight, bias, residual) = op.split(inputs);
        let [in_c, in_h, in_w] = [0, 1, 2].map(|i| recording.dims(input)[i] as u32);
        let [out_c, _, kh, kw] = [0, 1, 2, 3].map(|i| recording.dims(weight)[i] as u32);
        let [out_h, out_w] = [1, 2].map(|i| recording.dims(outputs[0])[i] as u32);
        let name = recording.info(weight).name.clone();
        let padded = (out_c as usize).next_multiple_of(CHANNELS);
        let spec = TensorSpec::f32([kh as usize, kw as usize, in_c as usize, padded]);
        let packed = recording.weights(op.name(), weight)?.packed(spec, pack_weight);
        let padded = padded_bias(op, recording, bias, out_c as usize, CHANNELS)?;
        let weight = recording.constant(format!("{name} (packed)"), packed);
        let bias = recording.constant(format!("{name} (bias)"), padded);
        let tiles = (out_h * out_w).div_ceil(PIXELS as u32);
        let groups = out_c.div_ceil(CHANNELS as u32);
        for (what, needed) in [("pixels", tiles), ("channels", groups)] {
            if needed > MAX_WORKGROUPS {
                return Err(Error::Capacity {
                    what: format!("conv2d: workgroups of 64 {what}"),
                    needed: needed.into(),
                    available: MAX_WORKGROUPS.into(),
                });
            }
        }
        let params = Params {
            in_channels: in_c,
            in_height: in_h,
            in_width: in_w,
            out_channels: out_c,
            out_height: out_h,
            out_width: out_w,
            kernel_height: kh,
            kernel_width: kw,
            stride: op.stride as u32,
            padding: op.padding as u32,
            dilation: op.dilation as u32,
            has_residual: u32::from(op.residual),
            relu: u32::from(op.relu),
        };
        let bindings = [
            ("input", input),
            ("weight", weight),
            ("bias", bias),
            // Any readable buffer serves where there is no residual: it is not read.
            ("residual", *residual.unwrap_or(&input)),
            ("output", outputs[0]),
        ];
        let grid = Grid::Workgroups([tiles, groups, 1]);
        recording.dispatch(Dispatch::new(&SHADER, "main", &params, &bindings, grid));
        Ok(())
    }
}

/// `[O, I, kh, kw]` to `[kh, kw, I, O']`, with zeros up to a whole number of [`CHANNELS`].
fn pack_weight(weight: &Tensor) -> Tensor {
    let [out_c, in_c, kh, kw] = [0, 1, 2, 3].map(|i| weight.dims()[i]);
    let padded = out_c.next_multiple_of(CHANNELS);
    let mut packed = Tensor::zeros([kh, kw, in_c, padded]);
    let to = packed.data_mut();
    for o in 0..out_c {
        for i in 0..in_c {
            for tap in 0..kh * kw {
                to[(tap * in_c + i) * padded + o] = weight.data()[(o * in_c + i) * kh * kw + tap];
            }
        }
    }
    packed
}
