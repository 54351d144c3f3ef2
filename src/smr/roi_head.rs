//! The RoI head: what each proposal is, and where exactly.

use crate::engine::graph::{Graph, TensorId};
use crate::engine::ops::{
    BoxVoting, DecodeDetections, DecodePose, GatherRows, Linear, Nms, RoiAlign,
};
use crate::error::Result;
use crate::smr::Choice;
use crate::smr::rpn::Proposals;
use crate::smr::weights::Weights;

/// Side of the pooled map.
const POOLED: usize = 7;
/// Sampling points a bin and side; with `aligned = true`, which differs from torchvision's default.
const SAMPLING: usize = 2;
/// Outputs of the layer for the pose.
const POSE: usize = 6;
/// Box coder weights of the second stage.
const CODER: [f32; 4] = [10.0, 10.0, 5.0, 5.0];
/// Intersection over union above which other boxes of its class move a detection.
const VOTE_IOU: f32 = 0.7;
/// Smallest side of a detection in pixels of the network's input, as in torchvision.
const MIN_SIZE: f32 = 1e-2;

/// What is wanted of a network, whatever its weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wanted {
    /// A detection's score must be above this.
    pub score: f32,
    /// Intersection over union above which the lower of two detections of a class goes.
    pub iou: f32,
    /// At most so many detections.
    pub max_detections: usize,
    /// Bit c set: class c is wanted; 0 is the background.
    pub class_mask: u32,
    /// At most so many proposals, the best, reach the RoI head.
    pub most_proposals: usize,
    /// Whether the deepest of the scales that RW-Net weighs is computed. Without it nothing of conv5_x is:
    /// its share of RW-Net's input is zero, and the softmax is over the other two. Says nothing without
    /// MSFF-Net or RW-Net.
    pub deepest: bool,
}

impl Wanted {
    /// Every detection above any score at all, as far as there is room, from every scale; twins go.
    pub const ALL: Self = Self {
        score: 0.0,
        iou: 0.5,
        max_detections: 100,
        class_mask: u32::MAX,
        most_proposals: 100,
        deepest: true,
    };
}

/// The detections' tensors, best first.
#[derive(Clone, Debug)]
pub(super) struct Head {
    /// `[N, 4]` in pixels of the network's input.
    pub boxes: TensorId,
    /// `[N]`.
    pub scores: TensorId,
    /// The scores' logits `[N]`, by which they are ordered.
    pub margins: TensorId,
    /// `[N]`, 1 for the first class.
    pub classes: TensorId,
    /// `[1]`.
    pub count: TensorId,
    /// `[N, 5]`, if the weights know the pose.
    pub pose: Option<TensorId>,
    /// Class logits, box deltas and what is said of the pose, a row a proposal.
    pub rows: Vec<TensorId>,
    /// How the detections were chosen.
    pub choice: Choice,
}

/// Appends the RoI head on the fused map.
pub(super) fn roi_head(
    graph: &mut Graph,
    weights: &mut Weights,
    ([height, width], wanted): ([usize; 2], Wanted),
    fused: TensorId,
    proposals: Proposals,
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
    let hidden = config.head;
    let fc6 = [hidden, config.width() * POOLED * POOLED];
    let x = linear(graph, weights, "roi_head.fc6", fc6, true, pooled, count)?;
    let x = linear(graph, weights, "roi_head.fc7", [hidden, hidden], true, x, count)?;
    let cls = [classes, hidden];
    let logits = linear(graph, weights, "roi_head.cls_score", cls, false, x, count)?;
    let bbox = [4 * classes, hidden];
    let deltas = linear(graph, weights, "roi_head.bbox_pred", bbox, false, x, count)?;
    let pose = match config.pose {
        true => Some(linear(graph, weights, "roi_head.pose", [POSE, hidden], false, x, count)?),
        false => None,
    };

    graph.begin_stage("detections");
    let decode = DecodeDetections {
        width,
        height,
        weights: CODER,
        temperature: config.temperature,
        class_mask: wanted.class_mask,
    };
    let inputs = [proposals.boxes, deltas, logits, count];
    let candidates = graph.apply("roi_head.decode", decode, &inputs)?;
    let [boxes, scores, margins, labels, total] = [0, 1, 2, 3, 4].map(|i| candidates[i]);
    let nms = Nms {
        iou_threshold: wanted.iou,
        max_out: wanted.max_detections,
        min_score: wanted.score,
        min_size: MIN_SIZE,
        sorted: false,
        order: true,
        classes: true,
        count: true,
    };
    let kept = graph.apply("roi_head.nms", nms, &[boxes, scores, margins, labels, total])?;
    let choice = Choice {
        rule: nms,
        boxes,
        scores,
        order: margins,
        classes: Some(labels),
        count: total,
        keep: kept[0],
        kept: kept[1],
    };
    let rows = [logits, deltas].into_iter().chain(pose).collect();
    let mut vote = |name: &str, rows| {
        let inputs = [rows, boxes, scores, labels, kept[0], kept[1], total];
        graph.apply1(name, BoxVoting { iou_threshold: VOTE_IOU }, &inputs)
    };
    let voted = vote("detections.boxes", boxes)?;
    let pose = pose.map(|pose| vote("detections.pose_rows", pose)).transpose()?;
    let decode = |rows| graph.apply1("detections.pose", DecodePose {}, &[rows, kept[1]]);
    let pose = pose.map(decode).transpose()?;
    let mut gather =
        |name: &str, rows| graph.apply1(name, GatherRows {}, &[rows, kept[0], kept[1]]);
    let scores = gather("detections.scores", scores)?;
    let margins = gather("detections.margins", margins)?;
    let labels = gather("detections.labels", labels)?;
    graph.rename(kept[1], "detections.count");
    let (boxes, classes, count) = (voted, labels, kept[1]);
    Ok(Head { boxes, scores, margins, classes, count, pose, rows, choice })
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
