//! SAFE-Net: a ResNet of basic blocks, ResNet-34 in the paper, with a CBAM after conv1 and after each
//! of its four stages.

use crate::engine::graph::{Graph, TensorId};
use crate::engine::ops::{Conv2d, MaxPool2d};
use crate::error::Result;
use crate::smr::cbam::cbam;
use crate::smr::configuration::Variant;
use crate::smr::layers::conv_bn;
use crate::smr::weights::Weights;

/// What the backbone gives, each map after its stage's attention.
#[derive(Clone, Debug)]
pub(super) enum Features {
    /// For MSFF-Net: conv3_x, conv4_x and, if wanted, conv5_x at strides 8, 16, 32.
    Scales(Vec<TensorId>),
    /// Without it: conv4_x alone. Nothing reads conv5_x then, and no weight file has it.
    Conv4(TensorId),
}

/// Appends the backbone to `input` `[3, H, W]`, as far as the variant needs it, and without conv5_x unless
/// the `deepest` scale is wanted.
pub(super) fn backbone(
    graph: &mut Graph,
    weights: &mut Weights,
    input: TensorId,
    deepest: bool,
) -> Result<Features> {
    let config = weights.config().clone();
    let Variant { safe: attention, msff, .. } = config.variant;
    graph.begin_stage("backbone.conv1");
    let conv1 = Conv2d { stride: 2, padding: 3, relu: true, ..Conv2d::default() };
    let names = ("backbone.conv1", "backbone.bn1");
    let mut x = conv_bn(graph, weights, names, conv1, [config.stem, 3, 7, 7], &[input])?;
    if attention {
        x = cbam(graph, weights, "backbone.cbam1", x)?;
    }
    let pool = MaxPool2d { kernel: 3, stride: 2, padding: 1 };
    x = graph.apply1("backbone.maxpool", pool, &[x])?;
    let mut in_channels = config.stem;
    let mut features = Vec::new();
    let stages = config.channels.into_iter().zip(config.blocks);
    for (index, (channels, blocks)) in stages.take(if msff && deepest { 4 } else { 3 }).enumerate()
    {
        let name = format!("backbone.layer{}", index + 1);
        graph.begin_stage(&name);
        for block in 0..blocks {
            let stride = if index > 0 && block == 0 { 2 } else { 1 };
            let block = format!("{name}.{block}");
            x = basic_block(graph, weights, &block, x, (in_channels, channels), stride)?;
            in_channels = channels;
        }
        graph.rename(x, &name);
        if attention {
            x = cbam(graph, weights, &format!("backbone.cbam{}", index + 2), x)?;
        }
        features.push(x);
    }
    Ok(match msff {
        true => Features::Scales(features.split_off(1)),
        false => Features::Conv4(x),
    })
}

/// ResNet's basic block: two 3×3 convolutions and a shortcut, which is a strided 1×1 convolution
/// where the shape changes.
fn basic_block(
    graph: &mut Graph,
    weights: &mut Weights,
    name: &str,
    input: TensorId,
    (in_channels, channels): (usize, usize),
    stride: usize,
) -> Result<TensorId> {
    let of = |part: &str| format!("{name}.{part}");
    let conv = Conv2d { padding: 1, relu: true, ..Conv2d::default() };
    let first = Conv2d { stride, ..conv };
    let shape = [channels, in_channels, 3, 3];
    let x = conv_bn(graph, weights, (&of("conv1"), &of("bn1")), first, shape, &[input])?;
    let shortcut = if stride != 1 || in_channels != channels {
        let names = (of("downsample.0"), of("downsample.1"));
        let down = Conv2d { stride, ..Conv2d::default() };
        let shape = [channels, in_channels, 1, 1];
        conv_bn(graph, weights, (&names.0, &names.1), down, shape, &[input])?
    } else {
        input
    };
    let second = Conv2d { residual: true, ..conv };
    let shape = [channels, channels, 3, 3];
    conv_bn(graph, weights, (&of("conv2"), &of("bn2")), second, shape, &[x, shortcut])
}
