//! SMR-Net, stage by stage: backbone with attention, fusion, proposals, RoI head.

mod backbone;
pub mod catalog;
mod cbam;
mod configuration;
mod fusion;
mod layers;
mod roi_head;
mod rpn;
mod weights;

pub use catalog::Catalog;
pub use configuration::{MAX_CLASSES, ModelConfig, Variant};
pub use roi_head::Wanted;
pub use weights::{Bytes, MAX_FILE, WeightSource, Weights};

use std::ops::Range;

use backbone::Features;
use cbam::POOLED;

use crate::engine::graph::{Graph, TensorId};
use crate::engine::ops::{CropResize, Nms, NotFinite, not_finite};
use crate::engine::reference::Crop;
use crate::engine::shape::{Extent, MAX_BYTES, MAX_PIXELS, TensorSpec};
use crate::error::{Error, Result};

/// Most multiplications, each with an addition, that a network may ask for at the size of the paper's gel, and as
/// many more as an input is larger: some seven times those of the large network. They take cores a second.
pub const MOST_WORK: u64 = 64_000_000_000;

/// What of a weight file serves the deepest scale alone.
const DEEPEST: [&str; 4] =
    ["backbone.layer4.", "backbone.cbam5.", "fusion.branch3.", "reweight.reduce3."];

/// The whole network as a graph, with the ids of what goes in and comes out.
pub struct Network {
    /// The operations.
    pub graph: Graph,
    /// The configuration that the weights carry.
    pub config: ModelConfig,
    /// Height and width of the input in pixels.
    pub size: [usize; 2],
    /// Input: the picture's bytes, four a word, u32 `[MAX_PIXELS]` or shorter.
    pub picture: TensorId,
    /// Input: where the picture's part lies and what it is resized to, u32 `[Crop::WORDS]`, as
    /// [`Crop::to_tensor`] gives it.
    pub crop: TensorId,
    /// Output: boxes in pixels of the network's input, `[N, 4]`.
    pub boxes: TensorId,
    /// Output: scores `[N]`.
    pub scores: TensorId,
    /// Output: the scores' logits `[N]`, by which detections are ordered.
    pub margins: TensorId,
    /// Output: classes `[N]`, 1 for the first of `config.classes`.
    pub classes: TensorId,
    /// Output: how many of the N there are, `[1]`.
    pub count: TensorId,
    /// Output: the pose of each, `[N, 5]` as [`crate::engine::ops::DecodePose`] gives it, if the weights know it.
    pub pose: Option<TensorId>,
    /// Output: how many proposals the RoI head saw, `[1]`.
    pub proposal_count: TensorId,
    /// Objectness logits of every anchor, `[A, H, W]`.
    pub objectness: TensorId,
    /// Which anchor each candidate for a proposal is, `[K]`.
    pub anchors: TensorId,
    /// The proposals, from the candidates.
    pub proposals: Choice,
    /// The detections, from a box for each proposal and class.
    pub detections: Choice,
    /// Whether it has all scales that its weights know.
    pub deepest: bool,
    /// Tensors by which a value that is not finite is noticed, in the order in which they come about.
    pub witnesses: Vec<Witness>,
}

impl std::fmt::Debug for Network {
    /// A line: what it takes and knows, and how much there is.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (classes, [height, width]) = (self.config.classes.join(", "), self.size);
        write!(f, "Network({width} × {height}, classes {classes}, {:?})", self.graph)
    }
}

/// A choice by non-maximum suppression. What it chooses from has a row for each of N.
#[derive(Clone, Copy, Debug)]
pub struct Choice {
    /// How it was made.
    pub rule: Nms,
    /// Boxes in pixels of the network's input, `[N, 4]`.
    pub boxes: TensorId,
    /// Scores `[N]`, which [`Nms::min_score`] is about.
    pub scores: TensorId,
    /// The scores' logits `[N]`, by which the boxes are ordered: scores close to 1 are equal in f32 where
    /// these differ.
    pub order: TensorId,
    /// Classes `[N]`, if boxes of different classes are no rivals.
    pub classes: Option<TensorId>,
    /// How many of the N there are, `[1]`.
    pub count: TensorId,
    /// Places of the chosen among the N, best first.
    pub keep: TensorId,
    /// How many were chosen, `[1]`.
    pub kept: TensorId,
}

/// A tensor in which the network looks for values that are not finite.
#[derive(Clone, Debug)]
pub struct Witness {
    /// Where it shows that something overflowed: a stage, or a head's output.
    pub stage: String,
    /// The tensor.
    pub tensor: TensorId,
    /// Output: how many values of this tensor and others are not finite, u32, in parts as [`NotFinite`] gives them.
    pub counts: TensorId,
    /// Which of those parts are this tensor's.
    pub places: Range<usize>,
}

/// What the attentions pool over space, `[2, C]` each, with the stage that each belongs to.
fn pooled_by_stage(graph: &Graph) -> Vec<(String, TensorId)> {
    let of = |(at, stage): (usize, &String)| -> Vec<(String, TensorId)> {
        let pooled = graph.computed_in(at).filter(|id| graph.name(*id).ends_with(POOLED));
        pooled.map(|id| (stage.clone(), id)).collect()
    };
    graph.stages().iter().enumerate().flat_map(of).collect()
}

impl Network {
    /// Builds the network from `weights`, for inputs of `size`: height and width in pixels.
    ///
    /// # Errors
    /// [`Error::Weights`] for a configuration out of its ranges and for tensors that are missing,
    /// misshapen or left over, though without [`Wanted::deepest`] not for those that serve that scale alone;
    /// [`Error::Param`] for a size that is not [`ModelConfig::INPUT_SIZES`]; [`Error::Capacity`] for a tensor
    /// that no device need hold, by WebGPU's limits, so that no weight file asks the CPU for gigabytes, and for
    /// more than [`MOST_WORK`].
    pub fn new(mut weights: Weights, size: [usize; 2], wanted: Wanted) -> Result<Self> {
        let config = weights.config().clone();
        // Untrained weights come with a configuration that nothing has looked at yet.
        config.check().map_err(|message| Error::Weights { file: "weights".into(), message })?;
        for (name, side) in [("height", size[0]), ("width", size[1])] {
            if !ModelConfig::is_input_size(side) {
                return Err(Error::param("network", name, ModelConfig::INPUT_SIZES, side));
            }
        }
        let mut graph = Graph::default();
        let picture = graph.input("picture", TensorSpec::u32([MAX_PIXELS]), Extent::UpTo);
        let crop = graph.input("crop", TensorSpec::u32([Crop::WORDS]), Extent::Exact);
        graph.begin_stage("input");
        let resize =
            CropResize { width: size[1], height: size[0], mean: config.mean, std: config.std };
        let input = graph.apply1("input", resize, &[picture, crop])?;
        let deepest = wanted.deepest || !config.variant.leaves_deepest();
        if !deepest {
            DEEPEST.iter().for_each(|part| weights.leave(part));
        }
        let features = backbone::backbone(&mut graph, &mut weights, input, deepest)?;
        let (fused, scales) = match features {
            Features::Scales(scales) => fusion::fusion(&mut graph, &mut weights, scales)?,
            Features::Conv4(map) => (map, None),
        };
        let settings = (size, wanted);
        let proposals = rpn::rpn(&mut graph, &mut weights, settings, fused)?;
        let head = roi_head::roi_head(&mut graph, &mut weights, settings, fused, proposals)?;
        weights.finish()?;
        let paper = config.paper_size() as f64;
        let area = (size[0] * size[1]) as f64 / (paper * paper);
        let (needed, available) =
            (graph.multiply_adds(), (MOST_WORK as f64 * area.max(1.0)) as u64);
        if needed > available {
            let what =
                format!("multiplications of the weights at {} × {} pixels", size[0], size[1]);
            return Err(Error::Capacity { what, needed, available });
        }
        for id in graph.computed() {
            let (name, spec) = (graph.name(id), graph.spec(id));
            if spec.bytes() > MAX_BYTES {
                let what = format!("bytes for tensor `{name}` ({spec})");
                let (needed, available) = (spec.bytes(), MAX_BYTES);
                return Err(Error::Capacity { what, needed, available });
            }
        }
        // A channel's mean is not finite where one of its values is not: what each stage's attention
        // pools tells of all its map. Then what each head gave: NaN stays NaN from where it arises to
        // these, while comparisons behind them would only drop it.
        let pooled = pooled_by_stage(&graph);
        graph.begin_stage("check");
        let named = |tensor| (graph.name(tensor).to_owned(), tensor);
        let maps = scales.into_iter().chain(proposals.maps).map(named);
        let maps: Vec<_> = pooled.into_iter().chain(maps).collect();
        let rows: Vec<_> = head.rows.into_iter().map(named).collect();
        let (mut witnesses, mut looks) = (Vec::new(), Vec::new());
        for (name, tensors, count) in
            [("maps.not_finite", maps, None), ("rows.not_finite", rows, Some(proposals.count))]
        {
            let inputs: Vec<_> = tensors.iter().map(|(_, id)| *id).chain(count).collect();
            let op = NotFinite { values: tensors.len(), count: count.is_some() };
            let counts = graph.apply1(name, op, &inputs)?;
            looks.push(counts);
            let mut first = 0;
            for (stage, tensor) in tensors {
                let end = first + not_finite::chunks(graph.spec(tensor));
                witnesses.push(Witness { stage, tensor, counts, places: first..end });
                first = end;
            }
        }
        let outputs =
            [head.boxes, head.scores, head.margins, head.classes, head.count, proposals.count];
        for id in outputs.into_iter().chain(head.pose).chain(looks) {
            graph.mark_output(id);
        }
        Ok(Self {
            graph,
            config,
            size,
            picture,
            crop,
            boxes: head.boxes,
            scores: head.scores,
            margins: head.margins,
            classes: head.classes,
            count: head.count,
            pose: head.pose,
            proposal_count: proposals.count,
            objectness: proposals.maps[0],
            anchors: proposals.anchors,
            proposals: proposals.choice,
            detections: head.choice,
            deepest,
            witnesses,
        })
    }
}
