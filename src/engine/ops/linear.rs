//! A fully connected layer.

use crate::engine::ops::bounds::{Joined, SumOrder, magnitude};
use crate::engine::ops::case::{
    Case, exact_dot, integers, one_way, one_way_sum, random, stiff_dot, values,
};
use crate::engine::ops::count::{expect_count, live};
use crate::engine::ops::op::{Entry, Op, Tolerance, dims, expect};
use crate::engine::ops::params::{Param, Params as Named, Range, Settings};
use crate::engine::reference;
use crate::engine::shape::{DType, Shape, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "linear",
    takes: "input [R, …] or [K], weight [O, K], bias [O]; optional: count u32 [1]",
    gives: "output [R, O] or [O]",
    params: &[Param::optional("relu", "false", Range::Flag)],
    build,
    cases,
};

/// Most slices that a row of inputs is cut into.
const MAX_SLICES: usize = 16;
/// Fewest vec4 of inputs in a slice: shorter ones cost more to add than to compute.
const MIN_SLICE: usize = 16;

/// PyTorch's `linear`, then ReLU if `relu`, on the rows below the count.
///
/// Inputs: `input` f32 `[R, …]`, K elements a row, or `[K]`, one row; `weight` f32 `[O, K]` and `bias` f32 `[O]`, known
/// when recording; `count` u32 `[1]` if `count`. Output: `output` f32 `[R, O]`, or `[O]`; rows behind the
/// count are not written.
#[derive(Clone, Copy, Debug, Default)]
pub struct Linear {
    /// Whether a ReLU comes last.
    pub relu: bool,
    /// Whether a count limits the rows.
    pub count: bool,
}

impl Op for Linear {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        vec![("relu", self.relu.into())]
    }

    fn inputs(&self) -> Vec<&'static str> {
        let mut names = vec!["input", "weight", "bias"];
        names.extend(self.count.then_some("count"));
        names
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [outputs, inner] = dims(name, "weight", &inputs[1], DType::F32)?;
        let shape = &inputs[0].shape;
        let fits = shape.rank() > 0 && shape.elements() == rows(shape) * inner;
        if !fits || shape.elements() == 0 || outputs == 0 || inputs[0].dtype != DType::F32 {
            let expected =
                format!("f32 [{inner}], or [R, …] with {inner} elements a row, none zero");
            return Err(Error::tensor(name, "input", expected, &inputs[0]));
        }
        expect(name, "bias", &TensorSpec::f32([outputs]), &inputs[2])?;
        expect_count(name, inputs.get(3))?;
        Ok(vec![match shape.rank() {
            1 => TensorSpec::f32([outputs]),
            _ => TensorSpec::f32([shape.0[0], outputs]),
        }])
    }

    fn compute(&self, inputs: &[&Value], specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let (input, weight, bias) = (inputs[0].f32()?, inputs[1].f32()?, inputs[2].f32()?);
        let rows = live(inputs.get(3).copied(), rows(input.shape()))?;
        let mut output = reference::linear(input, weight, bias, rows, self.relu).into_data();
        output.resize(specs[0].shape.elements(), 0.0);
        Ok(vec![Tensor::new(specs[0].shape.clone(), output)?.into()])
    }

    /// The shader sums the products of each slice, then the slices and the bias.
    fn tolerance(&self, inputs: &[&Value], reference: &[Value]) -> Result<Vec<Tolerance>> {
        let (input, weight) = (magnitude(inputs[0])?, magnitude(inputs[1])?);
        let rows = live(inputs.get(3).copied(), rows(input.shape()))?;
        let sums = reference::linear(&input, &weight, &magnitude(inputs[2])?, rows, false);
        let (slices, slice_quads) = slices(weight.dims()[1]);
        let order =
            SumOrder { terms: 4 * slice_quads, parts: slices, joined: Joined::InOrder, more: 1 };
        let mut each: Vec<f64> = sums.data().iter().map(|s| order.error(f64::from(*s))).collect();
        each.resize(reference[0].spec().shape.elements(), 0.0);
        Ok(vec![Tolerance::Each(each)])
    }

    fn unbiased(&self) -> bool {
        true
    }

    /// Of all rows, whatever a count says.
    fn multiply_adds(&self, inputs: &[TensorSpec], outputs: &[TensorSpec]) -> u64 {
        (outputs[0].shape.elements() * inputs[1].shape.0[1]) as u64
    }

    fn defined(&self, reference: &[&Value], inputs: &[&Value]) -> Vec<usize> {
        let shape = reference[0].spec().shape;
        let all = rows(&shape);
        let counted = live(inputs.get(3).copied(), all).unwrap_or(0);
        vec![counted * (shape.elements() / all)]
    }
}

/// How many rows an input or an output has: a vector is one.
pub(crate) fn rows(shape: &Shape) -> usize {
    if shape.rank() == 1 { 1 } else { shape.0.first().copied().unwrap_or(1) }
}

/// Into how many slices a row of `inner` inputs is cut, and how many vec4 each has at most.
pub(crate) fn slices(inner: usize) -> (usize, usize) {
    let quads = inner.div_ceil(4);
    let each = quads.div_ceil(MAX_SLICES).max(MIN_SLICE);
    (quads.div_ceil(each), each)
}

fn build(params: &mut Named, present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(Linear { relu: params.take("relu", false)?, count: present.contains(&"count") }))
}

fn cases() -> Vec<Case> {
    let plain = Linear::default();
    let counted = Linear { relu: true, count: true };
    let by_hand = || {
        vec![
            values([2, 3], &[1.0, 2.0, 3.0, -1.0, 0.5, 4.0]),
            values([2, 3], &[1.0, 1.0, 1.0, 2.0, -2.0, 0.25]),
            values([2], &[0.5, -1.0]),
        ]
    };
    let mut cases = vec![
        // 1 + 2 + 3 + 0.5; 2 − 4 + 0.75 − 1; −1 + 0.5 + 4 + 0.5; −2 − 1 + 1 − 1.
        Case::new("by hand", plain, by_hand())
            .by_hand(vec![values([2, 2], &[6.5, -2.25, 4.0, -3.0])]),
        Case::new("a vector by hand", plain, {
            let mut inputs = by_hand();
            inputs[0] = values([3], &[-1.0, 0.5, 4.0]);
            inputs
        })
        .by_hand(vec![values([2], &[4.0, -3.0])]),
        Case::new("ReLU and one row counted by hand", counted, {
            let mut inputs = by_hand();
            inputs.push(integers([1], &[1]));
            inputs
        })
        .by_hand(vec![values([2, 2], &[6.5, 0.0, 0.0, 0.0])]),
        // PyTorch's ReLU keeps it: an overflow must reach the outputs.
        Case::new(
            "a NaN goes through the ReLU",
            Linear { relu: true, count: false },
            vec![
                values([3, 1], &[-1.0, f32::NAN, 0.5]),
                values([1, 1], &[1.0]),
                values([1], &[0.0]),
            ],
        )
        .by_hand(vec![values([3, 1], &[0.0, f32::NAN, 0.5])]),
        // 1 + 2 + 3: what stands behind a row is another's, and no zero of the padding meets what is
        // read in its place.
        Case::new(
            "infinities at both ends of a row by hand",
            plain,
            vec![
                values([3, 3], &[1.0, 2.0, 3.0, f32::INFINITY, 1.0, 1.0, 1.0, 1.0, f32::INFINITY]),
                values([1, 3], &[1.0; 3]),
                values([1], &[0.0]),
            ],
        )
        .by_hand(vec![values([3, 1], &[6.0, f32::INFINITY, f32::INFINITY])]),
    ];
    // (name, input, outputs, count, relu)
    let sets = [
        ("one of everything", vec![1, 1], 1, None, false),
        ("primes", vec![7, 61], 37, None, true),
        ("a tile less one, a slice less one", vec![7, 63], 255, Some(7), false),
        ("a tile and one, a slice and one", vec![9, 65], 257, Some(9), false),
        ("a whole tile", vec![8, 12], 5, None, false),
        ("two whole tiles, counted", vec![20, 12], 5, Some(16), false),
        ("a row of feature maps", vec![11, 16, 7, 7], 20, Some(10), true),
        ("fc6, narrow", vec![17, 256, 7, 7], 68, Some(17), true),
        ("fc7", vec![100, 512], 512, Some(13), true),
        ("nothing counted", vec![5, 10], 4, Some(0), false),
        ("counted above all", vec![5, 12], 6, Some(u32::MAX), false),
        ("a grid folded to two dimensions", vec![524_289, 1], 1, None, false),
        ("a vector", vec![61], 37, None, true),
        ("a vector, not counted", vec![12], 5, Some(0), false),
    ];
    for (seed, (name, shape, outputs, count, relu)) in sets.into_iter().enumerate() {
        let seed = seed as u64 * 10;
        let inner = shape.iter().product::<usize>() / rows(&Shape(shape.clone()));
        let mut inputs: Vec<Value> = vec![
            random(seed, Shape(shape)).into(),
            random(seed + 1, [outputs, inner]).into(),
            random(seed + 2, [outputs]).into(),
        ];
        inputs.extend(count.map(|n| integers([1], &[n])));
        cases.push(Case::new(name, Linear { relu, count: count.is_some() }, inputs));
    }
    // Large against small: the bound grows with Σ|w||x|, not with the result.
    let mut wide = random(99, [6, 250]);
    for (i, x) in wide.data_mut().iter_mut().enumerate() {
        *x *= 10f32.powi((i % 13) as i32 - 6);
    }
    let inputs = vec![wide.into(), random(98, [9, 250]).into(), random(97, [9]).into()];
    cases.push(Case::new("twelve orders of magnitude", plain, inputs));
    for (seed, condition) in [1e4, 1e8, 1e12].into_iter().enumerate() {
        let pairs = [0, 1, 2].map(|i| stiff_dot(300 + 10 * seed as u64 + i, 250, condition));
        let rows = |which: usize| -> Value {
            Tensor::from_fn([3, 250], |i| pairs[i / 250][which][i % 250]).into()
        };
        let dots =
            Tensor::from_fn([3, 3], |i| exact_dot(&pairs[i % 3][1], &pairs[i / 3][0]) as f32);
        let inputs = vec![rows(0), rows(1), values([3], &[0.0; 3])];
        let name = format!("dot products of condition {condition:e}, exact");
        cases.push(Case::new(name, plain, inputs).by_hand(vec![dots.into()]));
    }
    // Four times 3e38 less three times that.
    let near_end = Tensor::from_fn([2, 8], |i| if i % 8 < 4 { 3e38 } else { -3e38 });
    let weight = Tensor::from_fn([3, 8], |i| if i % 8 < 7 { 1.0 } else { 0.0 });
    let inputs = vec![near_end.into(), weight.into(), values([3], &[0.0; 3])];
    cases.push(Case::new("an overflow on the way, which f64 hides", plain, inputs));
    let layers = [
        (vec![100, 256, 7, 7], 512, true),
        (vec![100, 512], 512, true),
        (vec![100, 512], 3, false),
        (vec![100, 512], 12, false),
        (vec![100, 512], 6, false),
        (vec![768], 64, true),
        (vec![64], 3, false),
        (vec![512], 64, true),
        (vec![64], 2, false),
    ];
    for (i, (shape, outputs, relu)) in layers.into_iter().enumerate() {
        let seed = 1000 + i as u64 * 10;
        let shape = Shape(shape);
        let each = rows(&shape);
        let inner = shape.elements() / each;
        let mut inputs = vec![
            one_way(seed, shape).into(),
            one_way(seed + 1, [outputs, inner]).into(),
            one_way_sum(seed + 2, [outputs], inner),
        ];
        let (count, of) = (each > 1, if each > 1 { "RoI head" } else { "weights of the scales" });
        inputs.extend(count.then(|| integers([1], &[each as u32])));
        let name = format!("{inner} to {outputs}, as the {of}");
        cases.push(Case::new(name, Linear { relu, count }, inputs).in_network());
    }
    cases
}
