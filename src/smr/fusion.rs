//! MSFF-Net and RW-Net: three scales, or without the deepest two, brought to one size and summed by learned
//! weights.

use crate::engine::graph::{Graph, TensorId};
use crate::engine::ops::{Conv2d, GlobalAvgPool, Linear, Softmax, UpsampleBilinear, WeightedSum};
use crate::engine::shape::{Shape, TensorSpec};
use crate::engine::tensor::Tensor;
use crate::error::{Error, Result};
use crate::smr::cbam::cbam;
use crate::smr::layers::{conv_bn, convolve};
use crate::smr::weights::{Folded, Weights};

/// The scales' dilations. The paper gives the two deeper scales a 5×5 field, read as a 3×3 kernel with
/// dilation 2.
const DILATIONS: [usize; SCALES] = [1, 2, 2];
/// How many scales the weights know.
const SCALES: usize = 3;

/// Appends the fusion of `features`, a map a scale; returns the fused map `[F, H/8, W/8]` and, with RW-Net,
/// the weights of the scales.
pub(super) fn fusion(
    graph: &mut Graph,
    weights: &mut Weights,
    features: Vec<TensorId>,
) -> Result<(TensorId, Option<TensorId>)> {
    graph.begin_stage("fusion");
    let size = graph.spec(features[0]).shape.0.clone();
    let mut maps = Vec::new();
    let fused = weights.config().fused;
    for (i, (feature, dilation)) in features.into_iter().zip(DILATIONS).enumerate() {
        let name = format!("fusion.branch{}", i + 1);
        let op = Conv2d { padding: dilation, dilation, relu: true, ..Conv2d::default() };
        let names = (format!("{name}.conv"), format!("{name}.bn"));
        let shape = [fused, graph.spec(feature).shape.0[0], 3, 3];
        let x = conv_bn(graph, weights, (&names.0, &names.1), op, shape, &[feature])?;
        let x = cbam(graph, weights, &format!("{name}.cbam"), x)?;
        let up = UpsampleBilinear { out_height: size[1], out_width: size[2] };
        let x = match i {
            0 => x,
            _ => graph.apply1(&name, up, &[x])?,
        };
        graph.rename(x, &name);
        maps.push(x);
    }
    match weights.config().variant.rw {
        true => {
            let scales = scale_weights(graph, weights, &maps)?;
            let inputs = [&[scales], &maps[..]].concat();
            let sum = WeightedSum { maps: maps.len() };
            Ok((graph.apply1("fusion.fused", sum, &inputs)?, Some(scales)))
        }
        false => Ok((reduce_concatenation(graph, weights, &maps)?, None)),
    }
}

/// RW-Net: 1×1 convolution and average of each scale, an MLP over all three, softmax.
///
/// Convolution and average are both linear, as is the MLP's first layer, and the paper puts nothing
/// between them: so the maps are averaged first, and the 1×1 convolutions are folded into that
/// layer when loading, in f64. It then reads the averages side by side, and without the deepest scale it
/// and the layer behind it are that much smaller.
fn scale_weights(graph: &mut Graph, weights: &mut Weights, maps: &[TensorId]) -> Result<TensorId> {
    graph.begin_stage("reweight");
    let (reduced, channels) = (weights.config().reweight, weights.config().fused);
    let scales = maps.len();
    let weight = weights.take("reweight.fc1.weight", [reduced, SCALES * reduced])?;
    let bias = weights.take("reweight.fc1.bias", [reduced])?;
    let fc2_weight = first_rows(&weights.take("reweight.fc2.weight", [SCALES, reduced])?, scales);
    let fc2_bias = first_rows(&weights.take("reweight.fc2.bias", [SCALES])?, scales);
    let mut sums = vec![0f64; reduced * scales * channels];
    let mut bias: Vec<f64> = bias.data().iter().map(|b| f64::from(*b)).collect();
    for scale in 0..scales {
        let name = format!("reweight.reduce{}", scale + 1);
        let reduce = weights.take(&format!("{name}.weight"), [reduced, channels, 1, 1])?;
        let reduce_bias = weights.take(&format!("{name}.bias"), [reduced])?;
        for hidden in 0..reduced {
            let row = &weight.data()[(hidden * SCALES + scale) * reduced..][..reduced];
            let to = &mut sums[(hidden * scales + scale) * channels..][..channels];
            for (k, w) in row.iter().enumerate() {
                let w = f64::from(*w);
                bias[hidden] += w * f64::from(reduce_bias.data()[k]);
                for (sum, r) in to.iter_mut().zip(&reduce.data()[k * channels..]) {
                    *sum += w * f64::from(*r);
                }
            }
        }
    }
    let fc1_weight = Tensor::from_fn([reduced, scales * channels], |i| sums[i] as f32);
    let fc1_bias = Tensor::from_fn([reduced], |i| bias[i] as f32);
    weights.check_finite("reweight.fc1.weight", &fc1_weight)?;
    weights.check_finite("reweight.fc1.bias", &fc1_bias)?;
    let mut x = graph.apply1("reweight.pool", GlobalAvgPool { maps: scales }, maps)?;
    // Networks share weights by name, and these differ from those of all scales.
    let only = if scales < SCALES { ".without_deepest" } else { "" };
    let layers = [
        ("reweight.fc1", Folded { weight: fc1_weight.into(), bias: fc1_bias.into() }, true),
        ("reweight.fc2", Folded { weight: fc2_weight.into(), bias: fc2_bias.into() }, false),
    ];
    for (name, Folded { weight, bias }, relu) in layers {
        let weight = graph.constant(format!("{name}.weight{only}"), weight);
        let bias = graph.constant(format!("{name}.bias{only}"), bias);
        x = graph.apply1(name, Linear { relu, count: false }, &[x, weight, bias])?;
    }
    graph.apply1("reweight.weights", Softmax::default(), &[x])
}

/// The first `rows` of a matrix, or of a vector.
fn first_rows(tensor: &Tensor, rows: usize) -> Tensor {
    let mut dims = tensor.dims().to_vec();
    dims[0] = rows;
    Tensor::from_fn(Shape(dims), |i| tensor.data()[i])
}

/// Without RW-Net: a 1×1 convolution of the concatenated scales to F channels, as the sum of one
/// convolution a scale, so that nothing is copied together.
fn reduce_concatenation(
    graph: &mut Graph,
    weights: &mut Weights,
    maps: &[TensorId],
) -> Result<TensorId> {
    let channels = weights.config().fused;
    let total = weights.take_biased("fusion.reduce", [channels, SCALES * channels, 1, 1])?;
    let mut sum = None;
    for (scale, map) in maps.iter().enumerate() {
        let shape = [channels, channels, 1, 1];
        let weight = total.weight.packed(TensorSpec::f32(shape), move |total| {
            Tensor::from_fn(shape, |i| {
                let (out, from) = (i / channels, i % channels);
                total.data()[(out * SCALES + scale) * channels + from]
            })
        });
        let bias = match scale {
            0 => total.bias.clone(),
            _ => Tensor::<f32>::zeros([channels]).into(),
        };
        let op = Conv2d { residual: sum.is_some(), ..Conv2d::default() };
        let inputs: Vec<_> = [*map].into_iter().chain(sum).collect();
        let name = match scale + 1 {
            SCALES => "fusion.fused".into(),
            number => format!("fusion.reduce{number}"),
        };
        sum = Some(convolve(graph, &name, op, Folded { weight, bias }, &inputs)?);
    }
    sum.ok_or_else(|| Error::tensor("fusion", "maps", "three scales", 0))
}
