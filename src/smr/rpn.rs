//! The region proposal network: where on the fused map there may be a snap.
//!
//! The fusion replaces the RPN's own 3×3 convolution, so class and box are 1×1 convolutions on the
//! fused map; a plain Faster R-CNN has it. Order, box coding, clipping and limits follow torchvision.

use crate::engine::graph::{Graph, TensorId};
use crate::engine::ops::{Conv2d, DecodeProposals, GatherRows, Nms, TopK};
use crate::error::Result;
use crate::smr::layers::conv;
use crate::smr::weights::Weights;
use crate::smr::{Choice, Wanted};

/// Candidates that enter the non-maximum suppression for each proposal that may leave it: torchvision's 1000
/// for 100, and of a part that has few proposals as many less.
const CANDIDATES: usize = 10;
/// Intersection over union above which the lower of two proposals goes.
const IOU: f32 = 0.7;
/// Smallest side of a proposal, in pixels of the network's input.
const MIN_SIZE: f32 = 1e-3;

/// Boxes `[N, 4]` in pixels of the network's input, best first, and how many there are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Proposals {
    pub boxes: TensorId,
    pub count: TensorId,
    /// Objectness logits and box deltas of every anchor, `[A, H, W]` and `[4A, H, W]`.
    pub maps: [TensorId; 2],
    /// Which anchor each candidate is, best first.
    pub anchors: TensorId,
    /// How they were chosen from the candidates.
    pub choice: Choice,
}

/// Appends the RPN on the fused map.
pub(super) fn rpn(
    graph: &mut Graph,
    weights: &mut Weights,
    ([height, width], wanted): ([usize; 2], Wanted),
    fused: TensorId,
) -> Result<Proposals> {
    graph.begin_stage("rpn");
    let config = weights.config().clone();
    let anchors = config.cell_anchors();
    let (a, channels) = (anchors.len(), config.width());
    let map = match config.variant.rpn_conv {
        true => {
            let op = Conv2d { padding: 1, relu: true, ..Conv2d::default() };
            conv(graph, weights, "rpn.conv", op, [channels, channels, 3, 3], fused)?
        }
        false => fused,
    };
    let head = Conv2d::default();
    let scores = conv(graph, weights, "rpn.cls", head, [a, channels, 1, 1], map)?;
    let deltas = conv(graph, weights, "rpn.bbox", head, [4 * a, channels, 1, 1], map)?;

    graph.begin_stage("proposals");
    let candidates = TopK { k: CANDIDATES * wanted.most_proposals, count: false };
    let best = graph.apply("rpn.top_k", candidates, &[scores])?;
    let (logits, indices, count) = (best[0], best[1], best[2]);
    let decode = DecodeProposals { anchors, stride: config.stride, width, height };
    let decoded = graph.apply("rpn.decode", decode, &[deltas, logits, indices, count])?;
    let nms = Nms {
        iou_threshold: IOU,
        max_out: wanted.most_proposals,
        min_size: MIN_SIZE,
        sorted: true,
        count: true,
        ..Nms::default()
    };
    let kept = graph.apply("rpn.nms", nms, &[decoded[0], decoded[1], count])?;
    let boxes = graph.apply1("proposals", GatherRows {}, &[decoded[0], kept[0], kept[1]])?;
    graph.apply1("proposal_scores", GatherRows {}, &[decoded[1], kept[0], kept[1]])?;
    graph.rename(kept[1], "proposal_count");
    let choice = Choice {
        rule: nms,
        boxes: decoded[0],
        scores: decoded[1],
        order: logits,
        classes: None,
        count,
        keep: kept[0],
        kept: kept[1],
    };
    Ok(Proposals { boxes, count: kept[1], maps: [scores, deltas], anchors: indices, choice })
}
