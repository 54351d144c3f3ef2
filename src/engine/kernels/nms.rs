//! Non-maximum suppression.

use crate::engine::kernels::count::count_tensor;
use crate::engine::kernels::{Caps, Dispatch, Grid, Io, Kernel, Recording, Work, top_k};
use crate::engine::ops::Nms;
use crate::engine::ops::nms::MAX_BOXES;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Tensor;
use crate::error::{Error, Result};

shader_params! {
    struct Params {
        boxes: u32,
        /// Words of 32 boxes in a row of the mask.
        words: u32,
        max_out: u32,
        iou_threshold: f32,
        min_score: f32,
        min_size: f32,
        has_classes: u32,
        /// Always 0; see `rounded` in shared/boxes.wgsl. As part of a bound it keeps the compiler from
        /// unrolling the loop, which takes seconds.
        zero: u32,
    }
}

static SHADER: Shader =
    Shader { stem: "nms", source: include_str!("../../../wgsl/nms.wgsl"), params: PARAMS };

/// The definition.
#[derive(Debug)]
pub(super) struct Planar;

impl Kernel for Planar {
    fn id(&self) -> &'static str {
        "nms/planar"
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(&SHADER, Variant::default())]
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &Nms = work.op()?;
        let (boxes, scores) = (inputs[0], inputs[1]);
        let [key, classes, count] = op.optional(inputs);
        let n = recording.dims(boxes)[0];
        if n > MAX_BOXES {
            return Err(Error::Capacity {
                what: "boxes for nms".into(),
                needed: n as u64,
                available: MAX_BOXES as u64,
            });
        }
        let (order, count) = if op.sorted {
            let order = recording.constant("order", Tensor::from_fn([n], |i| i as u32));
            (order, count_tensor(recording, count.copied(), n))
        } else {
            let values = recording.scratch("sorted keys", TensorSpec::f32([n]));
            let order = recording.scratch("order", TensorSpec::u32([n]));
            let sorted = recording.scratch("sorted", TensorSpec::u32([1]));
            let key = key.copied().unwrap_or(scores);
            let sort: Vec<_> = [Some(key), count.copied()].into_iter().flatten().collect();
            let sort = top_k::best(n, recording, (&sort, &[values, order, sorted]))?;
            recording.dispatch(sort);
            (order, sorted)
        };
        let words = n.div_ceil(32);
        let suppressed = recording.scratch("suppressed", TensorSpec::u32([n, words]));
        let params = Params {
            boxes: n as u32,
            words: words as u32,
            max_out: op.max_out.min(n) as u32,
            iou_threshold: op.iou_threshold,
            min_score: op.min_score,
            min_size: op.min_size,
            has_classes: u32::from(op.classes),
            zero: 0,
        };
        let bindings = [
            ("boxes", boxes),
            ("scores", scores),
            // Any readable buffer serves where there are no classes: it is not read.
            ("classes", *classes.unwrap_or(&order)),
            ("order", order),
            ("input_count", count),
            ("suppressed", suppressed),
        ];
        let grid = Grid::linear(n * words, 64);
        recording.dispatch(Dispatch::new(&SHADER, "mask", &params, &bindings, grid));
        let bindings = [
            ("order", order),
            ("input_count", count),
            ("suppressed", suppressed),
            ("keep", outputs[0]),
            ("output_count", outputs[1]),
        ];
        let grid = Grid::Workgroups([1, 1, 1]);
        recording.dispatch(Dispatch::new(&SHADER, "scan", &params, &bindings, grid));
        Ok(())
    }
}
