//! Operations: parameters and tensors of any kind end with the outputs that were announced, or with
//! an error.

use std::sync::OnceLock;

use smr_gpu::engine::ops::{Case, Entry, OPS, Op, Params};
use smr_gpu::engine::shape::{DType, TensorSpec};
use smr_gpu::engine::tensor::{Tensor, Value};

/// Most elements of a tensor, so that a run takes milliseconds.
const MAX_ELEMENTS: usize = 4096;

const TEXTS: [&str; 16] = [
    "0",
    "1",
    "2",
    "3",
    "7",
    "-1",
    "0.5",
    "1e-45",
    "3e38",
    "NaN",
    "inf",
    "-inf",
    "4294967295",
    "18446744073709551615",
    "",
    "1,2",
];
const FLOATS: [f32; 8] =
    [0.0, -0.0, 1.0, -1.0, f32::MAX, f32::MIN_POSITIVE, f32::NAN, f32::INFINITY];
const WHOLES: [u32; 6] = [0, 1, 2, 0x7fff_ffff, 0x8000_0000, u32::MAX];

/// Takes an operation's own case, changes it as the bytes say, and computes it.
pub fn run(data: &[u8]) {
    let mut bytes = Bytes(data);
    let entry = OPS[bytes.below(OPS.len())];
    let cases = small_cases(entry);
    if cases.is_empty() {
        return;
    }
    let case = &cases[bytes.below(cases.len())];
    let mut inputs = case.inputs.clone();
    let built = match bytes.below(3) {
        0 => None,
        _ => {
            let Some(op) = build(entry, case, &mut bytes) else { return };
            Some(op)
        }
    };
    let op = built.as_deref().unwrap_or(case.op.as_ref());
    for _ in 0..bytes.below(8) {
        change(&mut inputs, &mut bytes);
    }
    compute(op, &inputs);
}

/// The operation's cases that are small enough to be tried often.
fn small_cases(entry: &Entry) -> &'static [Case] {
    static CASES: OnceLock<Vec<(&str, Vec<Case>)>> = OnceLock::new();
    let is_small = |c: &Case| c.inputs.iter().all(|v| v.spec().shape.elements() <= MAX_ELEMENTS);
    let all = CASES.get_or_init(|| {
        let of = |e: &&'static Entry| (e.cases)().into_iter().filter(is_small).collect();
        OPS.iter().map(|entry| (entry.name, of(entry))).collect()
    });
    all.iter().find(|(name, _)| *name == entry.name).map_or(&[], |(_, cases)| cases)
}

/// The operation from parameters of any kind.
fn build(entry: &Entry, case: &Case, bytes: &mut Bytes) -> Option<Box<dyn Op>> {
    let mut values = Vec::new();
    // The others follow from the tensors that came.
    for param in entry.params.iter().filter(|p| !p.by_tensors) {
        let text = match bytes.below(4) {
            0 if !param.required => continue,
            0 | 1 => param.value.to_owned(),
            2 => TEXTS[bytes.below(TEXTS.len())].to_owned(),
            _ => f32::from_bits(bytes.word()).to_string(),
        };
        values.push((param.name.to_owned(), text));
    }
    let mut params = Params::new(entry.name, values);
    let op = (entry.build)(&mut params, &case.op.inputs()).ok()?;
    params.finish().ok()?;
    Some(op)
}

/// Changes a value, a dimension or a tensor.
fn change(inputs: &mut Vec<Value>, bytes: &mut Bytes) {
    if inputs.is_empty() {
        return;
    }
    let which = bytes.below(inputs.len());
    let value = &mut inputs[which];
    let TensorSpec { shape, dtype } = value.spec();
    let mut dims = shape.0;
    match bytes.below(8) {
        0..4 => match value {
            Value::F32(t) if !t.data().is_empty() => {
                let at = bytes.below(t.data().len());
                t.data_mut()[at] = match bytes.below(2) {
                    0 => FLOATS[bytes.below(FLOATS.len())],
                    _ => f32::from_bits(bytes.word()),
                };
            }
            Value::U32(t) if !t.data().is_empty() => {
                let at = bytes.below(t.data().len());
                t.data_mut()[at] = match bytes.below(2) {
                    0 => WHOLES[bytes.below(WHOLES.len())],
                    _ => bytes.word(),
                };
            }
            _ => {}
        },
        4 | 5 if !dims.is_empty() => {
            let at = bytes.below(dims.len());
            dims[at] = bytes.below(10);
            *value = resized(value, dims, dtype);
        }
        6 => {
            match bytes.below(2) {
                0 => drop(dims.pop()),
                _ => dims.push(bytes.below(4)),
            }
            *value = resized(value, dims, dtype);
        }
        _ => match bytes.below(3) {
            0 => drop(inputs.remove(which)),
            1 => inputs.push(inputs[which].clone()),
            _ => {
                let other = if dtype == DType::F32 { DType::U32 } else { DType::F32 };
                *value = resized(value, dims, other);
            }
        },
    }
}

/// A tensor of other dimensions or another type, from the old one's bits over and over.
fn resized(value: &Value, dims: Vec<usize>, dtype: DType) -> Value {
    let old: Vec<u32> = match value {
        Value::F32(t) => t.data().iter().map(|v| v.to_bits()).collect(),
        Value::U32(t) => t.data().to_vec(),
    };
    let mut bits = old.iter().copied().cycle();
    let shape = smr_gpu::engine::shape::Shape(dims);
    if shape.elements() > 4 * MAX_ELEMENTS {
        return value.clone();
    }
    let mut next = |_| bits.next().unwrap_or(0);
    match dtype {
        DType::U32 => Tensor::from_fn(shape, next).into(),
        DType::F32 => Tensor::from_fn(shape, |i| f32::from_bits(next(i))).into(),
    }
}

fn compute(op: &dyn Op, inputs: &[Value]) {
    let specs: Vec<_> = inputs.iter().map(Value::spec).collect();
    let inputs: Vec<_> = inputs.iter().collect();
    let announced = match op.infer(&specs) {
        Ok(announced) => announced,
        Err(_) => {
            op.reference(&inputs).expect_err("inputs that were refused are computed");
            return;
        }
    };
    assert_eq!(announced.len(), op.outputs().len());
    if announced.iter().any(|spec| spec.shape.elements() > 4 * MAX_ELEMENTS) {
        return;
    }
    let Ok(outputs) = op.reference(&inputs) else { return };
    let got: Vec<_> = outputs.iter().map(Value::spec).collect();
    assert_eq!(got, announced, "{op:?} with {specs:?}");
    let defined = op.defined(&outputs.iter().collect::<Vec<_>>(), &inputs);
    for (spec, defined) in got.iter().zip(defined) {
        assert!(defined <= spec.shape.elements(), "{op:?}: {defined} elements of {spec}");
    }
}

/// Decisions from bytes; zeros when they are used up.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn byte(&mut self) -> u8 {
        let Some((first, rest)) = self.0.split_first() else { return 0 };
        self.0 = rest;
        *first
    }

    fn word(&mut self) -> u32 {
        u32::from_le_bytes([(); 4].map(|()| self.byte()))
    }

    /// A number below `n`, which is at least 1.
    fn below(&mut self, n: usize) -> usize {
        match n {
            0..=256 => usize::from(self.byte()) % n,
            _ => usize::from(u16::from_le_bytes([self.byte(), self.byte()])) % n,
        }
    }
}
