//! 2-D convolution with bias, optional residual and ReLU.

use crate::engine::ops::bounds::{Joined, SumOrder, magnitude, moved_sum};
use crate::engine::ops::case::{Case, exact_dot, one_way, one_way_sum, random, stiff_dot};
use crate::engine::ops::op::{Entry, Op, Tolerance, dims, expect};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::precision::{Precision, weight_errors};
use crate::engine::reference::{self, ConvShape};
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "conv2d",
    takes: "input [I, H, W], weight [O, I, kh, kw]; optional: bias [O], residual [O, H', W']",
    gives: "output [O, H', W']",
    params: &[
        Param::optional("stride", "1", Range::Whole(1, MAX_PARAM)),
        Param::optional("padding", "0", Range::Whole(0, MAX_PARAM)),
        Param::optional("dilation", "1", Range::Whole(1, MAX_PARAM)),
        Param::optional("relu", "false", Range::Flag),
    ],
    build,
    cases,
};

/// Largest stride, dilation and padding: far past any use, and safe in the shader's u32 arithmetic.
const MAX_PARAM: u64 = 4096;
/// Most bytes of the reference's copy of its input with the padding: far past any use.
const MAX_COPY: u64 = 4 << 30;
/// Output channels that one workgroup computes.
pub(crate) const CHANNELS: usize = 64;

/// PyTorch's `conv2d` on `[C, H, W]`, then `+ residual`, then ReLU.
///
/// Inputs: `input [I, H, W]`, `weight [O, I, kh, kw]`, `bias [O]` if `bias`, `residual [O, H', W']`
/// if `residual`. Output: `output [O, H', W']`.
#[derive(Clone, Copy, Debug)]
pub struct Conv2d {
    /// Step between outputs.
    pub stride: usize,
    /// Zeros on each side.
    pub padding: usize,
    /// Step between taps.
    pub dilation: usize,
    /// Whether there is a bias.
    pub bias: bool,
    /// Whether a residual is added before the ReLU.
    pub residual: bool,
    /// Whether a ReLU comes last.
    pub relu: bool,
}

impl Default for Conv2d {
    fn default() -> Self {
        Self { stride: 1, padding: 0, dilation: 1, bias: true, residual: false, relu: false }
    }
}

impl Conv2d {
    /// The convolution's geometry.
    pub(crate) fn shape(&self) -> ConvShape {
        ConvShape { stride: self.stride, padding: self.padding, dilation: self.dilation }
    }

    /// Splits the inputs that came into the named ones.
    pub(crate) fn split<'a, T>(
        &self,
        inputs: &'a [T],
    ) -> (&'a T, &'a T, Option<&'a T>, Option<&'a T>) {
        let bias = self.bias.then(|| &inputs[2]);
        let residual = self.residual.then(|| &inputs[2 + usize::from(self.bias)]);
        (&inputs[0], &inputs[1], bias, residual)
    }

    /// Checks that there is room for the reference's copy of its input, which no device makes.
    fn check_copy(&self, input: &Tensor, weight: &Tensor) -> Result<()> {
        let dims = [0, 1, 2].map(|i| input.dims()[i]);
        let needed = self.shape().copied_bytes(dims, weight.dims()[3]);
        if needed > MAX_COPY {
            let what = "conv2d: bytes of the padded input".into();
            return Err(Error::Capacity { what, needed, available: MAX_COPY });
        }
        Ok(())
    }

    /// How far each output may be from the reference's, of a kernel that sums in this order.
    pub(crate) fn summed(
        &self,
        inputs: &[&Value],
        order: SumOrder,
        precision: Precision,
    ) -> Result<Vec<Tolerance>> {
        let (input, weight, bias, residual) = self.split(inputs);
        let bias = bias.map(|v| magnitude(v)).transpose()?;
        let residual = residual.map(|v| magnitude(v)).transpose()?;
        let half = precision.is_half().then(|| weight.f32().map(weight_errors)).transpose()?;
        let (input, weight) = (magnitude(input)?, magnitude(weight)?);
        let sums = reference::conv2d(
            &input,
            &weight,
            bias.as_ref(),
            residual.as_ref(),
            self.shape(),
            false,
        );
        let mut each: Vec<f64> = sums.data().iter().map(|s| order.error(f64::from(*s))).collect();
        if let Some(rounded) = half {
            let moved = reference::conv2d(&input, &rounded, None, None, self.shape(), false);
            each.iter_mut().zip(moved.data()).for_each(|(e, m)| *e += moved_sum(f64::from(*m)));
        }
        Ok(vec![Tolerance::Each(each)])
    }
}

impl Op for Conv2d {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![
            ("stride", self.stride.into()),
            ("padding", self.padding.into()),
            ("dilation", self.dilation.into()),
            ("relu", self.relu.into()),
        ]
    }

    fn inputs(&self) -> Vec<&'static str> {
        let mut names = vec!["input", "weight"];
        names.extend(self.bias.then_some("bias"));
        names.extend(self.residual.then_some("residual"));
        names
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let (input, weight, bias, residual) = self.split(inputs);
        let [in_c, in_h, in_w] = dims(name, "input", input, DType::F32)?;
        let [out_c, weight_c, kh, kw] = dims(name, "weight", weight, DType::F32)?;
        if weight_c != in_c || [out_c, in_c, kh, kw].contains(&0) {
            let expected = format!("[O, {in_c}, kh, kw] without a zero");
            return Err(Error::tensor(name, "weight", expected, weight));
        }
        let fits = self.shape().output(in_h, kh).zip(self.shape().output(in_w, kw));
        let Some((out_h, out_w)) = fits else {
            let expected = format!("at most the padded input ({input})");
            return Err(Error::tensor(name, "weight", expected, weight));
        };
        let output = TensorSpec::f32([out_c, out_h, out_w]);
        if let Some(bias) = bias {
            expect(name, "bias", &TensorSpec::f32([out_c]), bias)?;
        }
        if let Some(residual) = residual {
            expect(name, "residual", &output, residual)?;
        }
        Ok(vec![output])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let (input, weight, bias, residual) = self.split(inputs);
        let bias = bias.map(|v| v.f32()).transpose()?;
        let residual = residual.map(|v| v.f32()).transpose()?;
        let (input, weight) = (input.f32()?, weight.f32()?);
        self.check_copy(input, weight)?;
        Ok(vec![reference::conv2d(input, weight, bias, residual, self.shape(), self.relu).into()])
    }

    /// The shader sums the channels of each tap, then the taps, then bias and residual.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        let weight = self.split(inputs).1.spec();
        let [_, terms, kh, kw] = [0, 1, 2, 3].map(|i| weight.shape.0[i]);
        let order = SumOrder { terms, parts: kh * kw, joined: Joined::InOrder, more: 2 };
        self.summed(inputs, order, Precision::F32)
    }

    fn unbiased(&self) -> bool {
        true
    }

    fn multiply_adds(&self, inputs: &[TensorSpec], outputs: &[TensorSpec]) -> u64 {
        let each: usize = inputs[1].shape.0[1..].iter().product();
        (outputs[0].shape.elements() * each) as u64
    }
}

fn build(params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(Conv2d {
        stride: params.take("stride", 1)?,
        padding: params.take("padding", 0)?,
        dilation: params.take("dilation", 1)?,
        bias: present.contains(&"bias"),
        residual: present.contains(&"residual"),
        relu: params.take("relu", false)?,
    }))
}

fn cases() -> Vec<Case> {
    let tensor = |dims: &[usize], data: &[f32]| -> Value {
        Tensor::from_fn(crate::engine::shape::Shape(dims.to_vec()), |i| data[i]).into()
    };
    let mut cases = vec![
        // 2x2 kernel [[1, 2], [3, 4]] over [[1, 2, 3], [4, 5, 6], [7, 8, 9]], plus 0.5:
        // 1·1 + 2·2 + 3·4 + 4·5 = 37, and so on.
        Case::new(
            "2x2 by hand",
            Conv2d::default(),
            vec![
                tensor(&[1, 3, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]),
                tensor(&[1, 1, 2, 2], &[1.0, 2.0, 3.0, 4.0]),
                tensor(&[1], &[0.5]),
            ],
        )
        .by_hand(vec![tensor(&[1, 2, 2], &[37.5, 47.5, 67.5, 77.5])]),
        // Dilation 2 with padding 2 over one pixel: only the centre tap (5) sees it; 5·2 − 12 + 1
        // = −1, and the ReLU makes 0.
        Case::new(
            "dilated in padding, residual and ReLU by hand",
            Conv2d { padding: 2, dilation: 2, residual: true, relu: true, ..Conv2d::default() },
            vec![
                tensor(&[1, 1, 1], &[2.0]),
                tensor(&[2, 1, 3, 3], &std::array::from_fn::<f32, 18, _>(|i| (i % 9 + 1) as f32)),
                tensor(&[2], &[-12.0, 0.25]),
                tensor(&[2, 1, 1], &[1.0, -0.5]),
            ],
        )
        .by_hand(vec![tensor(&[2, 1, 1], &[0.0, 9.75])]),
    ];
    // Kernel rows (1, 2, 3) and, one above the other, (1, 2): 1·1 + 2·2 + 3·4 = 17 and so on. A
    // kernel with its sides exchanged would be of another size.
    let map = || tensor(&[1, 2, 4], &[1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0, 128.0]);
    let plain = Conv2d { bias: false, ..Conv2d::default() };
    cases.push(
        Case::new("1x3 by hand", plain, vec![map(), tensor(&[1, 1, 1, 3], &[1.0, 2.0, 3.0])])
            .by_hand(vec![tensor(&[1, 2, 2], &[17.0, 34.0, 272.0, 544.0])]),
    );
    cases.push(
        Case::new("2x1 by hand", plain, vec![map(), tensor(&[1, 1, 2, 1], &[1.0, 2.0])])
            .by_hand(vec![tensor(&[1, 1, 4], &[33.0, 66.0, 132.0, 264.0])]),
    );
    // Weights (1, 2), (3, 4) and (5, 6) over pixels (10, 1) and (−1, 100).
    cases.push(
        Case::new(
            "two channels to three by hand",
            Conv2d::default(),
            vec![
                tensor(&[2, 1, 2], &[10.0, -1.0, 1.0, 100.0]),
                tensor(&[3, 2, 1, 1], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
                tensor(&[3], &[0.5, 0.25, -1.0]),
            ],
        )
        .by_hand(vec![tensor(&[3, 1, 2], &[12.5, 199.5, 34.25, 397.25, 55.0, 594.0])]),
    );
    // Stride 3 with padding 1 looks at rows −1 and 2, dilation 2 at columns (−1, 1) and (2, 4). Row 2
    // is 1…6 in channel 0, weighted (10, 1), and 100…600 in channel 1, weighted (0, 1).
    let planes = Tensor::from_fn([2, 3, 6], |i| match (i / 18, i / 6 % 3) {
        (0, 2) => (i % 6 + 1) as f32,
        (1, 2) => (i % 6 + 1) as f32 * 100.0,
        _ => 7.0,
    });
    cases.push(
        Case::new(
            "stride, dilation, padding and channels by hand",
            Conv2d { stride: 3, padding: 1, dilation: 2, ..plain },
            vec![planes.into(), tensor(&[1, 2, 1, 2], &[10.0, 1.0, 0.0, 1.0])],
        )
        .by_hand(vec![tensor(&[1, 2, 2], &[0.0, 0.0, 202.0, 535.0])]),
    );
    // PyTorch's ReLU keeps it: an overflow must reach the outputs, where the host looks for it.
    cases.push(
        Case::new(
            "a NaN goes through the ReLU",
            Conv2d { relu: true, ..plain },
            vec![tensor(&[1, 1, 3], &[-1.0, f32::NAN, 0.5]), tensor(&[1, 1, 1, 1], &[1.0])],
        )
        .by_hand(vec![tensor(&[1, 1, 3], &[0.0, f32::NAN, 0.5])]),
    );
    // A kernel that reads a channel again, with weights of zero, makes NaN of it.
    let map = || tensor(&[1, 1, 3], &[-1.0, f32::INFINITY, 0.5]);
    cases.push(
        Case::new(
            "an infinity stays one by hand",
            plain,
            vec![map(), tensor(&[1, 1, 1, 1], &[2.0])],
        )
        .by_hand(vec![tensor(&[1, 1, 3], &[-2.0, f32::INFINITY, 1.0])]),
    );
    let taps = std::array::from_fn::<f32, 9, _>(|tap| (1 + tap) as f32);
    cases.push(
        Case::new(
            "an infinity beside a 3 × 3 kernel by hand",
            Conv2d { padding: 1, ..plain },
            vec![map(), tensor(&[1, 1, 3, 3], &taps)],
        )
        .by_hand(vec![tensor(&[1, 1, 3], &[f32::INFINITY; 3])]),
    );
    for (seed, [kh, kw]) in [(200, [1, 3]), (210, [3, 1]), (220, [5, 3]), (230, [2, 7])] {
        let op = Conv2d { stride: 2, padding: 3, bias: false, ..Conv2d::default() };
        let inputs =
            vec![random(seed, [3, 11, 17]).into(), random(seed + 1, [5, 3, kh, kw]).into()];
        cases.push(Case::new(format!("a kernel of {kh} × {kw}"), op, inputs));
    }
    // (name, in_c, h, w, out_c, kernel, stride, padding, dilation, bias, residual, relu)
    let shapes = [
        ("one of everything", 1, 1, 1, 1, 1, 1, 0, 1, true, false, false),
        ("1x1 head, odd channels", 61, 13, 7, 37, 1, 1, 0, 1, true, false, false),
        ("3x3 of prime sizes", 5, 17, 19, 13, 3, 1, 1, 1, true, true, true),
        ("7x7 stride 2, as conv1", 3, 31, 29, 64, 7, 2, 3, 1, true, false, true),
        ("3x3 dilation 2, as the fusion", 16, 10, 11, 31, 3, 1, 2, 2, true, false, true),
        (
            "3x3 dilation 3, whole groups and a part of one",
            5,
            6,
            41,
            17,
            3,
            1,
            3,
            3,
            true,
            true,
            false,
        ),
        ("3x3 dilation 4, wider than the map", 5, 3, 2, 4, 3, 1, 4, 4, true, false, false),
        ("3x3 stride 2 of odd sizes", 6, 13, 23, 18, 3, 2, 1, 1, true, true, true),
        ("3x3 stride 2 without padding", 5, 8, 18, 9, 3, 2, 0, 1, true, false, false),
        ("1x1 stride 2, as a downsample", 8, 9, 9, 16, 1, 2, 0, 1, false, false, false),
        ("63 pixels: a workgroup less one", 3, 1, 63, 16, 1, 1, 0, 1, false, false, false),
        (
            "65 pixels and channels: a workgroup and one",
            3,
            1,
            65,
            65,
            1,
            1,
            0,
            1,
            false,
            true,
            false,
        ),
        ("kernel larger than the picture", 2, 3, 2, 4, 5, 1, 2, 1, true, false, false),
    ];
    for (i, s) in shapes.into_iter().enumerate() {
        let (name, in_c, h, w, out_c, kernel, stride, padding, dilation, bias, residual, relu) = s;
        let op = Conv2d { stride, padding, dilation, bias, residual, relu };
        let seed = i as u64 * 10;
        let mut inputs: Vec<Value> = vec![
            random(seed, [in_c, h, w]).into(),
            random(seed + 1, [out_c, in_c, kernel, kernel]).into(),
        ];
        if bias {
            inputs.push(random(seed + 2, [out_c]).into());
        }
        if residual {
            let out = |n| op.shape().output(n, kernel).unwrap_or(0);
            inputs.push(random(seed + 3, [out_c, out(h), out(w)]).into());
        }
        cases.push(Case::new(name, op, inputs));
    }
    // Large against small: the bound grows with Σ|w||x|, not with the result.
    let mut wide = random(99, [32, 6, 6]);
    for (i, x) in wide.data_mut().iter_mut().enumerate() {
        *x *= 10f32.powi((i % 13) as i32 - 6);
    }
    let op = Conv2d { padding: 1, bias: false, ..Conv2d::default() };
    let inputs = vec![wide.into(), random(98, [8, 32, 3, 3]).into()];
    cases.push(Case::new("twelve orders of magnitude", op, inputs));
    cases.extend(stiff());
    // Each of the network: (in_c, edge, out_c, kernel, stride, padding, dilation, residual, relu).
    let layers = [
        (3, 320, 64, 7, 2, 3, 1, false, true),
        (64, 80, 64, 3, 1, 1, 1, false, true),
        (64, 80, 64, 3, 1, 1, 1, true, true),
        (64, 80, 128, 3, 2, 1, 1, false, true),
        (64, 80, 128, 1, 2, 0, 1, false, false),
        (128, 40, 128, 3, 1, 1, 1, false, true),
        (128, 40, 128, 3, 1, 1, 1, true, true),
        (128, 40, 256, 3, 2, 1, 1, false, true),
        (128, 40, 256, 1, 2, 0, 1, false, false),
        (256, 20, 256, 3, 1, 1, 1, false, true),
        (256, 20, 256, 3, 1, 1, 1, true, true),
        (256, 20, 512, 3, 2, 1, 1, false, true),
        (256, 20, 512, 1, 2, 0, 1, false, false),
        (512, 10, 512, 3, 1, 1, 1, false, true),
        (512, 10, 512, 3, 1, 1, 1, true, true),
        (128, 40, 256, 3, 1, 1, 1, false, true),
        (256, 20, 256, 3, 1, 2, 2, false, true),
        (512, 10, 256, 3, 1, 2, 2, false, true),
        (256, 40, 20, 1, 1, 0, 1, false, false),
        (256, 40, 80, 1, 1, 0, 1, false, false),
    ];
    for (i, layer) in layers.into_iter().enumerate() {
        let (in_c, edge, out_c, kernel, stride, padding, dilation, residual, relu) = layer;
        let op = Conv2d { stride, padding, dilation, bias: true, residual, relu };
        let seed = 1000 + i as u64 * 10;
        let terms = in_c * kernel * kernel;
        let mut inputs: Vec<Value> = vec![
            one_way(seed, [in_c, edge, edge]).into(),
            one_way(seed + 1, [out_c, in_c, kernel, kernel]).into(),
            one_way_sum(seed + 2, [out_c], terms),
        ];
        if residual {
            inputs.push(one_way_sum(seed + 3, [out_c, edge, edge], terms));
        }
        let mut name = format!("{in_c} to {out_c} at {edge} × {edge}, {kernel} × {kernel}");
        for (what, step) in [("stride", stride), ("dilation", dilation)] {
            if step > 1 {
                name += &format!(", {what} {step}");
            }
        }
        if residual {
            name += ", residual";
        }
        cases.push(Case::new(name, op, inputs).in_network());
    }
    cases
}

/// Sums in which nearly everything cancels, and weights and inputs at the ends of their range.
fn stiff() -> Vec<Case> {
    let plain = Conv2d { bias: false, ..Conv2d::default() };
    let padded = Conv2d { padding: 1, ..plain };
    let mut cases = Vec::new();
    // Each output channel's weights with each pixel's channels; those of one number are the stiff ones.
    for (seed, condition) in [1e4, 1e6, 1e8, 1e10, 1e12].into_iter().enumerate() {
        let pairs = [0, 1, 2].map(|i| stiff_dot(300 + 10 * seed as u64 + i, 64, condition));
        let input = Tensor::from_fn([64, 1, 3], |i| pairs[i % 3][1][i / 3]);
        let weight = Tensor::from_fn([3, 64, 1, 1], |i| pairs[i / 64][0][i % 64]);
        let dots =
            Tensor::from_fn([3, 1, 3], |i| exact_dot(&pairs[i / 3][0], &pairs[i % 3][1]) as f32);
        let name = format!("dot products of condition {condition:e}, exact");
        cases.push(
            Case::new(name, plain, vec![input.into(), weight.into()]).by_hand(vec![dots.into()]),
        );
    }
    // From here on as many channels as the fast kernels take, in and out.
    let (in_c, out_c) = (32, 16);
    // The same patch again and again: around every third pixel the sum is the stiff one. Each output
    // channel has half the weights of the one before.
    for (seed, condition) in [1e4, 1e8, 1e12].into_iter().enumerate() {
        let taps = in_c * 9;
        let [x, y] = stiff_dot(400 + seed as u64, taps, condition);
        let edge = 7;
        let patch = |c: usize, row: usize, column: usize| y[c * 9 + row % 3 * 3 + column % 3];
        let input = Tensor::from_fn([in_c, edge, edge], |i| {
            patch(i / (edge * edge), i / edge % edge, i % edge)
        });
        let halved = |i: usize| (-((i / taps) as f32)).exp2();
        let weight = Tensor::from_fn([out_c, in_c, 3, 3], |i| x[i % taps] * halved(i));
        let dots = Tensor::from_fn([out_c, edge, edge], |i| {
            let (o, at) = (i / (edge * edge), i % (edge * edge));
            let seen = |tap: usize| {
                let (row, column) = (at / edge + tap / 3 % 3, at % edge + tap % 3);
                let inside = (1..=edge).contains(&row) && (1..=edge).contains(&column);
                if inside { patch(tap / 9, row - 1, column - 1) } else { 0.0 }
            };
            exact_dot(&x, &(0..taps).map(seen).collect::<Vec<_>>()) as f32 * halved(o * taps)
        });
        let name = format!("3 × 3 taps of condition {condition:e}, exact");
        cases.push(
            Case::new(name, padded, vec![input.into(), weight.into()]).by_hand(vec![dots.into()]),
        );
    }
    let mut wide = random(310, [out_c, in_c, 3, 3]);
    for (i, w) in wide.data_mut().iter_mut().enumerate() {
        *w *= 10f32.powi((i * 7 % 13) as i32 - 6);
    }
    let inputs = vec![random(311, [in_c, 9, 10]).into(), wide.into()];
    cases.push(Case::new("weights of twelve orders of magnitude", padded, inputs));
    // A batch norm of variance 1e-12 and gains of ±1e3, 0 and 1, folded. What it was made for is a map
    // near one everywhere, of which the bias leaves next to nothing.
    let scales = [1e3, -1e3, 0.0, 1.0].map(|gain: f64| gain / (1e-12f64 + 1e-5).sqrt());
    let taps = random(312, [out_c, in_c, 3, 3]);
    let each = in_c * 9;
    let scale = |o: usize| scales[o % 4];
    let weight = Tensor::from_fn([out_c, in_c, 3, 3], |i| {
        (f64::from(taps.data()[i]) * scale(i / each)) as f32
    });
    let bias = Tensor::from_fn([out_c], |o| {
        let mean: f64 = taps.data()[o * each..][..each].iter().copied().map(f64::from).sum();
        (0.125 - mean * scale(o)) as f32
    });
    let mut near_one = random(313, [in_c, 9, 11]);
    near_one.data_mut().iter_mut().for_each(|x| *x = 1.0 + *x / 4096.0);
    for relu in [false, true] {
        let op = Conv2d { padding: 1, relu, ..Conv2d::default() };
        let with = if relu { ", with ReLU" } else { "" };
        let inputs = vec![near_one.clone().into(), weight.clone().into(), bias.clone().into()];
        cases.push(Case::new(format!("a batch norm of variance 1e-12 folded{with}"), op, inputs));
    }
    // What transforms of tiles make the most of: signs that alternate, against and with the kernel's.
    for (seed, scale) in [3e4, 1e15].into_iter().enumerate() {
        for with in [false, true] {
            let sign = |odd: usize| if odd.is_multiple_of(2) { 1.0 } else { -1.0 };
            let mut input = random(320 + seed as u64, [in_c, 9, 10]);
            for (i, x) in input.data_mut().iter_mut().enumerate() {
                *x = sign(i / 10 % 9 + i % 10) * scale * (1.0 + x.abs() / 64.0);
            }
            let mut weight = random(330, [out_c, in_c, 3, 3]);
            for (i, w) in weight.data_mut().iter_mut().enumerate() {
                *w = (if with { sign(i % 9) } else { 1.0 }) * (1.0 + w.abs());
            }
            let sums = if with { "added" } else { "cancelled" };
            let name = format!("alternating signs at {scale:e}, {sums}");
            cases.push(Case::new(name, padded, vec![input.into(), weight.into()]));
        }
    }
    let map = |at: usize, value: f32| -> Value {
        Tensor::from_fn([in_c, 8, 8], |i| if i == at { value } else { 0.0 }).into()
    };
    let kernel = || -> Value { random(340, [out_c, in_c, 3, 3]).into() };
    cases.push(Case::new("one spike of 1e30", padded, vec![map(91, 1e30), kernel()]));
    cases.push(
        Case::new("zeros by hand", padded, vec![map(0, 0.0), kernel()])
            .by_hand(vec![Tensor::<f32>::zeros([out_c, 8, 8]).into()]),
    );
    // Four times 3e38 less three times that.
    let near_end = Tensor::from_fn([8, 2, 3], |i| if i < 24 { 3e38 } else { -3e38 });
    let weight = Tensor::from_fn([4, 8, 1, 1], |i| if i % 8 < 7 { 1.0 } else { 0.0 });
    let inputs = vec![near_end.into(), weight.into()];
    cases.push(Case::new("an overflow on the way, which f64 hides", plain, inputs));
    let mut small = random(341, [in_c, 8, 8]);
    small.data_mut().iter_mut().for_each(|x| *x *= 1e-39);
    cases.push(Case::new("subnormal inputs", padded, vec![small.into(), kernel()]));
    cases
}
