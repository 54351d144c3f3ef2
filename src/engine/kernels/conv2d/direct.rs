//! On maps of four channels a texel, in registers.

use super::{Sizes, padded_bias, weights_known};
use std::borrow::Cow;

use crate::engine::graph::TensorId;
use crate::engine::kernels::products::{Lanes, most_slices};
use crate::engine::kernels::weights::{Packing, Stored};
use crate::engine::kernels::{
    Caps, Dispatch, Grid, Io, Kernel, Layout, MAX_WORKGROUPS, Quads, Recording, Work, texels,
};
use crate::engine::ops::bounds::{Joined, SumOrder};
use crate::engine::ops::{Conv2d, Op, Tolerance};
use crate::engine::precision::Precision;
use crate::engine::shader::{Shader, Variant, shader_params};
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::{Constant, Tensor, Value};
use crate::error::{Error, Result};

shader_params! {
    struct Params {
        input: Quads,
        output: Quads,
        kernel_height: u32,
        kernel_width: u32,
        stride: u32,
        padding: u32,
        dilation: u32,
        /// Groups of PIXELS in a row of outputs, and from one pixel of a group to the next.
        strips: u32,
        spacing: u32,
        blocks: u32,
        /// Blocks of a slice.
        split_blocks: u32,
        pictures: u32,
        /// Columns of `weight`.
        weight_width: u32,
        /// Tiles of outputs that see the same quads of inputs, and how many those are.
        group_tiles: u32,
        group_quads: u32,
        has_residual: u32,
        relu: u32,
        /// Quads of a block.
        block_quads: u32,
    }
}

static SHADER: Shader = Shader {
    stem: "conv2d/direct",
    source: include_str!("../../../../wgsl/conv2d/direct.wgsl"),
    params: PARAMS,
};

/// Workgroups that keep an adapter with many cores busy.
const ENOUGH: u64 = 256;
/// Farthest that an invocation's pixels lie apart: the farther, the more of them lie outside a small map.
const MOST_SPACING: usize = 4;

/// Taps of a row that are added together, and the inputs that they share.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Taps {
    /// One by one.
    One,
    /// The one of a kernel of 1 × 1 without padding.
    Pointwise,
    /// Of a kernel of 3 × 3 without stride: pixels as far apart as the taps are.
    Three,
    /// Of a kernel of 3 × 3 of stride 2, undilated: pixels side by side.
    ThreeOfStrideTwo,
}

impl Taps {
    const ALL: [Self; 4] = [Self::One, Self::Pointwise, Self::Three, Self::ThreeOfStrideTwo];

    fn number(self) -> usize {
        match self {
            Self::One | Self::Pointwise => 1,
            Self::Three | Self::ThreeOfStrideTwo => 3,
        }
    }

    /// `weights` says how those are stored in textures; for the maps see [`Recording::dispatch_maps`].
    fn variant(self, tile: &Tile, weights: Precision, caps: &Caps) -> Variant {
        let constants = vec![("WORKGROUP", tile.workgroup), ("SLICES", tile.slices)];
        let variant = Variant { constants, ..caps.input_variant() };
        let (spread, split) = (tile.weights == Weights::Spread, tile.slices > 1);
        let variant = Lanes::variant(tile.lanes.filter(|_| spread || split), variant)
            .with("SPREAD", spread)
            .with("SPLIT", split)
            .with("THREE_TAPS", self.number() == 3);
        let variant = variant.with("STRIDE_TWO", self == Self::ThreeOfStrideTwo);
        // A subgroup that spreads weights must not part, and texels of a texture have no index.
        let in_buffers = !spread && caps.input_layout() != Layout::Texture;
        let variant = variant.with("POINTWISE", in_buffers && self == Self::Pointwise);
        variant.with("HALF_WEIGHT", spread && weights.is_half())
    }
}

/// How the shader walks through a kernel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Form {
    taps: Taps,
    /// From one pixel that an invocation computes to the next.
    spacing: usize,
    /// Quads of input channels that are summed for themselves.
    quads: usize,
}

impl Form {
    fn of(op: &Conv2d, in_c: usize, kh: usize, kw: usize) -> Self {
        let (taps, spacing) = match [kh, kw, op.stride, op.dilation] {
            [3, 3, 1, dilation @ 1..=MOST_SPACING] => (Taps::Three, dilation),
            [3, 3, 2, 1] => (Taps::ThreeOfStrideTwo, 1),
            [1, 1, _, _] if op.padding == 0 => (Taps::Pointwise, 1),
            _ => (Taps::One, 1),
        };
        let most = if kh * kw == 1 { 8 } else { 4 };
        Self { taps, spacing, quads: in_c.div_ceil(4).min(most) }
    }

    fn blocks(&self, in_c: usize) -> usize {
        in_c.div_ceil(4).div_ceil(self.quads)
    }

    /// A block's products one after the other, the blocks, then bias and residual. Slices have fewer blocks, at
    /// least one less for each slice more.
    fn order(&self, in_c: usize, kh: usize, kw: usize) -> SumOrder {
        let (terms, parts) = (4 * self.quads * kh * kw, self.blocks(in_c));
        SumOrder { terms, parts, joined: Joined::InOrder, more: 2 }
    }
}

/// How weights come to all invocations of a workgroup.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::engine::kernels) enum Weights {
    /// The lanes of a subgroup read them from textures for each other.
    Spread,
    /// All read one address of a buffer, in f32 whatever the maps are stored in: GPUs that have scalar
    /// registers load it once, and would have to widen an f16 in each lane.
    Scalar,
}

/// How the invocations of a workgroup share the work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Tile {
    weights: Weights,
    lanes: Option<Lanes>,
    /// Invocations of a slice: of a workgroup, where sums are whole.
    workgroup: u32,
    /// Slices of a workgroup.
    slices: u32,
}

impl Tile {
    /// Output channels of an invocation.
    const CHANNELS: usize = 16;
    /// Pixels of an invocation.
    const PIXELS: usize = 4;

    /// Those of a kernel, of few slices first. None where weights are to be spread and there are no subgroups, and
    /// where a workgroup has no room for two slices.
    fn all(Direct { weights, split }: Direct, caps: &Caps) -> Vec<Self> {
        let lanes = Lanes::of(caps);
        let workgroup = match (weights, lanes) {
            // A slice is whole subgroups, so that each has one address.
            (Weights::Scalar, Some(lanes)) if split => lanes.workgroup,
            (Weights::Scalar, _) => caps.subgroup_min.clamp(32, 64),
            (Weights::Spread, Some(lanes)) => lanes.workgroup,
            (Weights::Spread, None) => return Vec::new(),
        };
        let most = most_slices(workgroup);
        let slices = if split { vec![most / 2, most] } else { vec![1] };
        let fits = |slices: &u32| !split || *slices > 1;
        let of = |slices| Self { weights, lanes, workgroup, slices };
        slices.into_iter().filter(fits).map(of).collect()
    }
}

/// A convolution cut into workgroups.
#[derive(Clone, Copy, Debug)]
struct Plan {
    sizes: Sizes,
    form: Form,
    tile: Tile,
    /// Groups of pixels in a row of outputs.
    strips: u32,
    /// Workgroups for one picture.
    busy: u64,
    /// Workgroups for the strips of all pictures, and for the channels.
    grid: [u32; 2],
    /// Columns and rows of the packed weights.
    texels: [usize; 2],
    split_blocks: u32,
}

/// What a plan is bound to.
struct Bound {
    input: TensorId,
    weight: Stored,
    bias: TensorId,
    residual: TensorId,
    output: TensorId,
    /// Where the output lies.
    to: Quads,
}

impl Plan {
    /// `None` for weights that fit no texture, for a grid past any adapter's limits, and without the subgroups
    /// that it needs.
    fn of(op: &Conv2d, sizes: Sizes, kernel: Direct, work: &Work) -> Option<Self> {
        let weights = kernel.weights;
        let Sizes { in_c, out_c, kh, kw, out_h, out_w } = sizes;
        let form = Form::of(op, in_c, kh, kw);
        let blocks = u32::try_from(form.blocks(in_c)).ok()?;
        let mut fitting = Tile::all(kernel, work.caps);
        fitting.retain(|tile| tile.slices <= blocks.max(1));
        let workgroup = fitting.first()?.workgroup as usize;
        let strips = out_w.div_ceil(Tile::PIXELS * form.spacing) * form.spacing;
        let tiles = out_c.div_ceil(Tile::CHANNELS);
        let across = |pictures: usize| (pictures * strips * out_h).div_ceil(workgroup);
        let busy = across(1) as u64 * tiles as u64;
        // By one picture: the order of its sums must not depend on the rest of its batch.
        let keeps_busy = |tile: &&Tile| busy * u64::from(tile.slices) >= ENOUGH;
        let tile = *fitting.iter().find(keeps_busy).or(fitting.last())?;

        let all = packed_texels(&sizes, &form);
        let texels = match weights {
            Weights::Spread => {
                let side = work.caps.texture_side as usize;
                let taps = form.taps.number() * Tile::CHANNELS;
                let width = (side / taps * taps).min(all);
                if width == 0 || all.div_ceil(width) > side {
                    return None;
                }
                [width, all.div_ceil(width)]
            }
            Weights::Scalar => {
                let bytes = all as u64 * u64::from(Precision::F32.texel_bytes());
                if bytes > work.caps.buffer_bytes {
                    return None;
                }
                [all, 1]
            }
        };

        let grid = [across(work.batch as usize), tiles];
        if grid.into_iter().any(|n| n > MAX_WORKGROUPS as usize) {
            return None;
        }
        let [strips, grid @ ..] = [strips, grid[0], grid[1]].map(|n| n as u32);
        let split_blocks = blocks.div_ceil(tile.slices);
        Some(Self { sizes, form, tile, strips, busy, grid, texels, split_blocks })
    }

    /// Adds the weights that `transform` makes of `weight`, whose outputs it repeats `copies` times; in
    /// `precision` where they lie in a texture.
    fn packed(
        &self,
        recording: &mut Recording,
        name: &str,
        weight: &Constant,
        precision: Precision,
        (copies, transform): (usize, fn(&Tensor) -> Cow<'_, Tensor>),
    ) -> Stored {
        let Self { form, tile, texels: [width, height], sizes, .. } = *self;
        let packing = Packing {
            texels: TensorSpec::f32([height, width, 4]),
            outputs: sizes.out_c.next_multiple_of(Tile::CHANNELS),
            tile: Tile::CHANNELS,
            copies,
            pack: move |w: &Tensor| pack_weight(&transform(w), &form, [width, height]),
        };
        match tile.weights {
            Weights::Spread => packing.record(recording, name, weight, precision),
            Weights::Scalar => packing.record_buffer(recording, name, weight),
        }
    }

    /// Appends the dispatch. Each of `groups` equal parts of the outputs sees its own part of the
    /// inputs.
    fn dispatch(
        &self,
        op: &Conv2d,
        recording: &mut Recording,
        bound: &Bound,
        groups: u32,
    ) -> Result<()> {
        let Self { sizes, form, tile, grid, .. } = *self;
        let input = recording.quads(bound.input)?;
        let params = Params {
            input,
            output: bound.to,
            kernel_height: sizes.kh as u32,
            kernel_width: sizes.kw as u32,
            stride: op.stride as u32,
            padding: op.padding as u32,
            dilation: op.dilation as u32,
            strips: self.strips,
            spacing: form.spacing as u32,
            blocks: form.blocks(sizes.in_c) as u32,
            split_blocks: self.split_blocks,
            pictures: recording.batch(),
            weight_width: self.texels[0] as u32,
            group_tiles: grid[1] / groups,
            group_quads: input.quads / groups,
            has_residual: u32::from(op.residual),
            relu: u32::from(op.relu),
            block_quads: form.quads as u32,
        };
        let bindings = [
            ("input", bound.input),
            ("weight", bound.weight.texels),
            ("bias", bound.bias),
            ("residual", bound.residual),
            ("output", bound.output),
        ];
        let bindings = bound.weight.scaled(&bindings);
        let grid = Grid::Workgroups([grid[0], grid[1], 1]);
        let dispatch = Dispatch::new(&SHADER, "main", &params, &bindings, grid);
        let precision = recording.info(bound.weight.texels).precision;
        let variant = form.taps.variant(&tile, precision, recording.caps());
        recording.dispatch_maps(dispatch.variant(variant), bound.input, bound.output);
        Ok(())
    }
}

/// Texels of the packed weights.
fn packed_texels(sizes: &Sizes, form: &Form) -> usize {
    let quads = form.blocks(sizes.in_c) * form.quads;
    sizes.out_c.next_multiple_of(Tile::CHANNELS) * quads * sizes.kh * sizes.kw
}

/// `[O, I, kh, kw]` to `[tile, quad, kh, kw, output of the tile, 4]`, in rows of texels, with zeros up
/// to whole tiles, blocks and rows.
fn pack_weight(weight: &Tensor, form: &Form, [width, height]: [usize; 2]) -> Tensor {
    let [out_c, in_c, kh, kw] = [0, 1, 2, 3].map(|i| weight.dims()[i]);
    let quads = form.blocks(in_c) * form.quads;
    let mut packed = Tensor::zeros([height, width, 4]);
    let to = packed.data_mut();
    for (o, kernel) in weight.data().chunks_exact(in_c * kh * kw).enumerate().take(out_c) {
        for (i, taps) in kernel.chunks_exact(kh * kw).enumerate() {
            let first = (o / Tile::CHANNELS * quads + i / 4) * kh * kw;
            for (tap, value) in taps.iter().enumerate() {
                let texel = (first + tap) * Tile::CHANNELS + o % Tile::CHANNELS;
                to[texel * 4 + i % 4] = *value;
            }
        }
    }
    packed
}

/// The definition, on maps of four channels a texel.
#[derive(Clone, Copy, Debug)]
pub(in crate::engine::kernels) struct Direct {
    pub weights: Weights,
    /// Whether sums are cut into slices, for adapters that a small map leaves idle.
    pub split: bool,
}

impl Direct {
    fn plan(&self, work: &Work) -> Option<Plan> {
        let op: &Conv2d = work.op().ok()?;
        let maps = [&work.inputs[0], &work.outputs[0]];
        let fits = weights_known(op, work.known) && maps.iter().all(|map| work.has_quads(map));
        fits.then(|| Plan::of(op, Sizes::of(op, work), *self, work)).flatten()
    }
}

impl Kernel for Direct {
    fn id(&self) -> &'static str {
        match (self.weights, self.split) {
            (Weights::Spread, false) => "conv2d/direct",
            (Weights::Spread, true) => "conv2d/split",
            (Weights::Scalar, false) => "conv2d/scalar",
            (Weights::Scalar, true) => "conv2d/scalar_split",
        }
    }

    fn shaders(&self, caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        use Precision::{F16, F32};
        // Weights, what is read, and what is written.
        let stored = [(F32, F32, F32), (F16, F16, F16), (F16, F16, F32), (F16, F32, F32)];
        let of = |tile: Tile, taps: Taps| {
            stored.map(|(w, read, written)| texels(taps.variant(&tile, w, caps), read, written))
        };
        let all = Tile::all(*self, caps)
            .into_iter()
            .flat_map(|tile| Taps::ALL.into_iter().flat_map(move |taps| of(tile, taps)));
        all.map(|variant| (&SHADER, variant)).collect()
    }

    fn fits(&self, work: &Work) -> bool {
        self.plan(work).is_some()
    }

    fn preferred(&self, work: &Work) -> bool {
        let idle = |plan: Plan| plan.busy < ENOUGH;
        let spread = Lanes::of(work.caps).is_some() && !work.caps.has_scalar_registers();
        let weights = if spread { Weights::Spread } else { Weights::Scalar };
        self.weights == weights
            && (!self.split || work.caps.has_many_cores() && self.plan(work).is_some_and(idle))
    }

    fn reads(&self, work: &Work, index: usize) -> Layout {
        match (index, work.inputs[index].shape.rank()) {
            (0, _) => work.caps.input_layout(),
            // The residual; weights are repacked.
            (_, 3) => Layout::Quads,
            _ => Layout::Planar,
        }
    }

    fn writes(&self, _work: &Work) -> Layout {
        Layout::Quads
    }

    fn batched(&self) -> bool {
        true
    }

    fn record(&self, work: &Work, recording: &mut Recording, (inputs, outputs): Io) -> Result<()> {
        let op: &Conv2d = work.op()?;
        let none = || Error::tensor(op.name(), "weight", "one that fits a texture", "a larger one");
        let plan = self.plan(work).ok_or_else(none)?;
        let (&input, &weight, bias, residual) = op.split(inputs);
        let name = recording.info(weight).name.clone();
        let weight = recording.weights(op.name(), weight)?;
        let as_it_is: fn(&Tensor) -> Cow<'_, Tensor> = |w| Cow::Borrowed(w);
        let weight = plan.packed(recording, &name, &weight, work.precision, (1, as_it_is));
        let out_c = plan.sizes.out_c;
        let bias = padded_bias(op, recording, bias, out_c, Tile::CHANNELS)?;
        let bias = recording.constant(format!("{name} (bias)"), bias);
        // Any readable buffer serves where there is no residual: it is not read.
        let residual = residual.copied().unwrap_or(bias);
        let (to, output) = (recording.quads(outputs[0])?, outputs[0]);
        let bound = Bound { input, weight, bias, residual, output, to };
        plan.dispatch(op, recording, &bound, 1)
    }

    fn tolerance(
        &self,
        op: &dyn Op,
        inputs: &[&Value],
        _reference: &[Value],
        precision: Precision,
    ) -> Result<Option<Vec<Tolerance>>> {
        let any: &dyn std::any::Any = op;
        let Some(op) = any.downcast_ref::<Conv2d>() else { return Ok(None) };
        let weight = op.split(inputs).1.spec();
        let [_, in_c, kh, kw] = [0, 1, 2, 3].map(|i| weight.shape.0[i]);
        let order = Form::of(op, in_c, kh, kw).order(in_c, kh, kw);
        let stored = match self.weights {
            Weights::Spread => precision,
            Weights::Scalar => Precision::F32,
        };
        op.summed(inputs, order, stored).map(Some)
    }
}

/// Products of matrices side by side: each group of channels of a map by a matrix of its own.
#[derive(Clone, Copy, Debug)]
pub(super) struct Products {
    plan: Plan,
    groups: usize,
}

impl Products {
    /// `groups` products of `in_c` to `out_c` channels for `columns` pixels. `None` where groups are no
    /// whole tiles, or a texture is too small.
    pub fn of(
        groups: usize,
        [in_c, out_c]: [usize; 2],
        columns: usize,
        work: &Work,
    ) -> Option<Self> {
        let out_c_all = groups * out_c;
        let sizes = Sizes { in_c, out_c: out_c_all, kh: 1, kw: 1, out_h: 1, out_w: columns };
        let spread = Direct { weights: Weights::Spread, split: false };
        let plan = Plan::of(&Conv2d::default(), sizes, spread, work)?;
        let whole = in_c.is_multiple_of(4) && out_c.is_multiple_of(Tile::CHANNELS);
        let maps = [in_c, out_c].map(|c| TensorSpec::f32([groups * c, 1, columns]));
        let fit = maps.iter().all(|map| work.has_quads(map));
        (whole && fit).then_some(Self { plan, groups })
    }

    /// The order of its sums over channels.
    pub fn order(in_c: usize) -> SumOrder {
        Form::of(&Conv2d::default(), in_c, 1, 1).order(in_c, 1, 1)
    }

    /// Appends the products of `input` `[groups · I, 1, columns]` and what `transform` makes of `weight`,
    /// `[groups · O, I, 1, 1]`, stored in `precision`.
    pub fn record(
        &self,
        recording: &mut Recording,
        name: &str,
        input: TensorId,
        (weight, precision): (&Constant, Precision),
        transform: fn(&Tensor) -> Cow<'_, Tensor>,
        output: TensorId,
    ) -> Result<()> {
        let transform = (self.groups, transform);
        let weight = self.plan.packed(recording, name, weight, precision, transform);
        let zeros = Tensor::<f32>::zeros([self.plan.sizes.out_c]);
        let bias = recording.constant(format!("{name} (no bias)"), zeros);
        let to = recording.quads(output)?;
        let bound = Bound { input, weight, bias, residual: bias, output, to };
        self.plan.dispatch(&Conv2d::default(), recording, &bound, self.groups as u32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 17 outputs of 6 channels by a 1 × 2 kernel in tiles of 16: output o of channel i at tap t is
    /// 100o + 10i + t + 1.
    #[test]
    fn weights_lie_as_they_are_read() {
        let weight = Tensor::from_fn([17, 6, 1, 2], |at| {
            let (o, i, tap) = (at / 12, at / 2 % 6, at % 2);
            (100 * o + 10 * i + tap + 1) as f32
        });
        let form = Form { taps: Taps::One, spacing: 1, quads: 1 };
        let packed = pack_weight(&weight, &form, [32, 4]);
        assert_eq!(packed.dims(), [4, 32, 4]);
        let texel = |at: usize| packed.data()[at * 4..][..4].to_vec();
        // Tile 0, quad 0: the outputs of the first tap, then those of the second.
        assert_eq!(texel(0), [1.0, 11.0, 21.0, 31.0]);
        assert_eq!(texel(3), [301.0, 311.0, 321.0, 331.0]);
        assert_eq!(texel(16), [2.0, 12.0, 22.0, 32.0]);
        // Quad 1 has two channels; tile 1 has one output.
        assert_eq!(texel(32), [41.0, 51.0, 0.0, 0.0]);
        assert_eq!(texel(64), [1601.0, 1611.0, 1621.0, 1631.0]);
        assert_eq!(texel(65), [0.0; 4]);
        assert_eq!(texel(112), [1642.0, 1652.0, 0.0, 0.0]);
    }

    #[test]
    fn blocks_are_padded_with_zeros() {
        let weight = Tensor::from_fn([1, 4, 1, 1], |_| 1.0);
        let form = Form { taps: Taps::One, spacing: 1, quads: 8 };
        let packed = pack_weight(&weight, &form, [128, 1]);
        let ones: Vec<usize> = (0..512).filter(|at| packed.data()[*at] != 0.0).collect();
        assert_eq!(ones, [0, 1, 2, 3]);
    }

    #[test]
    fn kernels_of_three_by_three_share_their_inputs() {
        let of = |kernel, stride, dilation, in_c| {
            Form::of(&Conv2d { stride, dilation, ..Conv2d::default() }, in_c, kernel, kernel)
        };
        let form = |taps, spacing, quads| Form { taps, spacing, quads };
        assert_eq!(of(3, 1, 1, 64), form(Taps::Three, 1, 4));
        assert_eq!(of(3, 1, 2, 256), form(Taps::Three, 2, 4));
        assert_eq!(of(3, 1, 5, 256), form(Taps::One, 1, 4));
        assert_eq!(of(3, 2, 1, 64), form(Taps::ThreeOfStrideTwo, 1, 4));
        assert_eq!(of(3, 2, 2, 64), form(Taps::One, 1, 4));
        assert_eq!(of(7, 2, 1, 3), form(Taps::One, 1, 1));
        assert_eq!(of(1, 2, 1, 64), form(Taps::Pointwise, 1, 8));
        let padded = Conv2d { padding: 1, ..Conv2d::default() };
        assert_eq!(Form::of(&padded, 64, 1, 1), form(Taps::One, 1, 8));
    }

    /// 64 channels of a pixel are 256 bytes; as 1 × 1 they are two blocks of sums.
    #[test]
    fn maps_fit_buffers_and_slices_fit_workgroups() {
        let fits = |split, subgroups, buffer_bytes| {
            let caps = Caps { buffer_bytes, ..Caps::default() }.with_subgroups(subgroups);
            let inputs = [TensorSpec::f32([64, 1, 1]), TensorSpec::f32([64, 64, 1, 1])];
            let work = Work {
                node: 0,
                op: &Conv2d { bias: false, ..Conv2d::default() },
                inputs: &inputs,
                known: &[false, true],
                outputs: &[TensorSpec::f32([64, 1, 1])],
                batch: 1,
                precision: Precision::F32,
                caps: &caps,
            };
            Direct { weights: Weights::Spread, split }.plan(&work).map(|plan| plan.tile.slices)
        };
        assert_eq!(fits(true, [32, 32], 256), None, "at least four slices");
        assert_eq!(fits(true, [64, 64], 256), Some(2));
        assert_eq!(fits(false, [32, 32], 256), Some(1));
        assert_eq!(fits(false, [32, 32], 255), None);
        assert_eq!(fits(true, [64, 128], 256), Some(2));
        assert_eq!(fits(true, [128, 256], 256), None, "two slices are 512 invocations");
        assert_eq!(fits(true, [0, 0], 256), None);
    }

    /// Cut into slices, a sum is no deeper than whole.
    #[test]
    fn slices_make_sums_no_deeper() {
        for blocks in 2u32..200 {
            for slices in 2..=most_slices(32).min(blocks) {
                let each = blocks.div_ceil(slices);
                let filled = blocks.div_ceil(each);
                assert!(each - 1 + filled - 1 < blocks, "{blocks} in {slices}");
            }
        }
    }
}
