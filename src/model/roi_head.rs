//! The RoI head: what each proposal is, and where exactly.

use crate::error::Result;
use crate::graph::{Graph, TensorId};
use crate::model::Choice;
use crate::model::fusion::CHANNELS;
use crate::model::rpn::Proposals;
use crate::model::weights::Weights;
use crate::ops::{DecodeDetections, GatherRows, Linear, Nms, RoiAlign, Softmax};

/// Side of the pooled map.
const POOLED: usize = 7;
/// Sampling points a bin and side; with `aligned = true`, which differs from torchvision's default.
const SAMPLING: usize = 2;
/// Width of the two fully connected layers.
const HIDDEN: usize = 512;
/// Box coder weights of the second stage.
const CODER: [f32; 4] = [10.0, 10.0, 5.0, 5.0];
/// Smallest side of a detection in pixels of the network's input, as in torchvision.
const MIN_SIZE: f32 = 1e-2;

/// What the user may choose about the last step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Thresholds {
    /// A detection's score must be above this.
    pub score: f32,
    /// Intersection over union above which the lower of two detections of a class goes.
    pub iou: f32,
    /// At most so many detections.
    pub max_detections: usize,
    /// Bit c set: class c is wanted; 0 is the background.
    pub class_mask: u32,
}

/// The detections' tensors, best first.
#[derive(Clone, Copy, Debug)]
pub(super) struct Head {
    /// `[N, 4]` in pixels of the network's input.
    pub boxes: TensorId,
    /// `[N]`.
    pub scores: TensorId,
    /// `[N]`, 1 for the first class.
    pub classes: TensorId,
    /// `[1]`.
    pub count: TensorId,
    /// Class probabilities and box deltas, a row a proposal.
    pub rows: [TensorId; 2],
    /// How the detections were chosen.
    pub choice: Choice,
}

/// Appends the RoI head on the fused map.
pub(super) fn roi_head(
    graph: &mut Graph,
    weights: &mut Weights,
    fused: TensorId,
    proposals: Proposals,
    thresholds: Thresholds,
) -> Result<Head> {
    graph.begin_stage("roi_head");
    let config = weights.config().clone();
    let classes = config.classes.len() + 1;
    let count = proposals.count;
    let align = RoiAlign {
        spatial_scale: 1.0 / config.stride as f32,
        output_size: POOLED,
        sampling_ratio: SAMPLING,
        count: true,
    };
    let pooled = graph.apply1("roi_head.pool", align, &[fused, proposals.boxes, count])?;
    let fc6 = [HIDDEN, CHANNELS * POOLED * POOLED];
    let x = linear(graph, weights, "roi_head.fc6", fc6, true, pooled, count)?;
    let x = linear(graph, weights, "roi_head.fc7", [HIDDEN, HIDDEN], true, x, count)?;
    let cls = [classes, HIDDEN];
    let logits = linear(graph, weights, "roi_head.cls_score", cls, false, x, count)?;
    let bbox = [4 * classes, HIDDEN];
    let deltas = linear(graph, weights, "roi_head.bbox_pred", bbox, false, x, count)?;
    let softmax = Softmax { count: true };
    let probabilities = graph.apply1("roi_head.probabilities", softmax, &[logits, count])?;

    graph.begin_stage("detections");
    let size = config.input_size;
    let decode = DecodeDetections {
        width: size,
        height: size,
        weights: CODER,
        class_mask: thresholds.class_mask,
    };
    let inputs = [proposals.boxes, deltas, probabilities, count];
    let candidates = graph.apply("roi_head.decode", decode, &inputs)?;
    let [boxes, scores, labels, total] = [0, 1, 2, 3].map(|i| candidates[i]);
    let nms = Nms {
        iou_threshold: thresholds.iou,
        max_out: thresholds.max_detections,
        min_score: thresholds.score,
        min_size: MIN_SIZE,
        sorted: false,
        classes: true,
        count: true,
    };
    let kept = graph.apply("roi_head.nms", nms, &[boxes, scores, labels, total])?;
    let mut gather =
        |name: &str, rows| graph.apply1(name, GatherRows {}, &[rows, kept[0], kept[1]]);
    let choice = Choice {
        rule: nms,
        boxes,
        order: scores,
        classes: Some(labels),
        count: total,
        keep: kept[0],
        kept: kept[1],
    };
    let boxes = gather("detections.boxes", boxes)?;
    let scores = gather("detections.scores", scores)?;
    let classes = gather("detections.labels", labels)?;
    graph.rename(kept[1], "detections.count");
    Ok(Head { boxes, scores, classes, count: kept[1], rows: [probabilities, deltas], choice })
}

fn linear(
    graph: &mut Graph,
    weights: &mut Weights,
    name: &str,
    shape: [usize; 2],
    relu: bool,
    input: TensorId,
    count: TensorId,
) -> Result<TensorId> {
    let layer = weights.take_biased(name, shape)?;
    let weight = graph.constant(format!("{name}.weight"), layer.weight);
    let bias = graph.constant(format!("{name}.bias"), layer.bias);
    graph.apply1(name, Linear { relu, count: true }, &[input, weight, bias, count])
}
