//! CBAM's channel gate.

use crate::engine::ops::bounds::{SumOrder, magnitude, sigmoid_error};
use crate::engine::ops::case::{Case, one_way, one_way_sum, random, random_scaled, values};
use crate::engine::ops::op::{Entry, Op, Tolerance, dims, expect};
use crate::engine::ops::params::{Params as Named, Settings};
use crate::engine::reference;
use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::{Error, Result};

/// This operation in [`crate::engine::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "channel_gate",
    takes: "pooled [2, C], fc1_weight [R, C], fc1_bias [R], fc2_weight [C, R], fc2_bias [C]",
    gives: "output [C]",
    params: &[],
    build,
    cases,
};

/// Invocations that share the columns of a row of the first layer.
const LANES: usize = 16;

/// CBAM's channel gate: `sigmoid(f(average) + f(maximum))`, `f(x) = fc2(relu(fc1(x)))`.
///
/// Inputs: `pooled [2, C]` from [`ChannelPool`](crate::engine::ops::ChannelPool), `fc1_weight [R, C]`,
/// `fc1_bias [R]`, `fc2_weight [C, R]`, `fc2_bias [C]`, R at most 1024 on a GPU. Output: `output [C]`.
#[derive(Clone, Copy, Debug, Default)]
pub struct ChannelGate;

impl Op for ChannelGate {
    fn entry(&self) -> &'static Entry {
        &ENTRY
    }

    fn settings(&self) -> Settings {
        Settings::new()
    }

    fn inputs(&self) -> Vec<&'static str> {
        vec!["pooled", "fc1_weight", "fc1_bias", "fc2_weight", "fc2_bias"]
    }

    fn outputs(&self) -> Vec<&'static str> {
        vec!["output"]
    }

    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        let name = self.name();
        let [rows, channels] = dims(name, "pooled", &inputs[0], DType::F32)?;
        if rows != 2 || channels == 0 {
            return Err(Error::tensor(name, "pooled", "[2, C] without a zero", &inputs[0]));
        }
        let [hidden, columns] = dims(name, "fc1_weight", &inputs[1], DType::F32)?;
        if columns != channels || hidden == 0 {
            let expected = format!("[R, {channels}] without a zero");
            return Err(Error::tensor(name, "fc1_weight", expected, &inputs[1]));
        }
        expect(name, "fc1_bias", &TensorSpec::f32([hidden]), &inputs[2])?;
        expect(name, "fc2_weight", &TensorSpec::f32([channels, hidden]), &inputs[3])?;
        expect(name, "fc2_bias", &TensorSpec::f32([channels]), &inputs[4])?;
        Ok(vec![TensorSpec::f32([channels])])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let [pooled, fc1_weight, fc1_bias, fc2_weight, fc2_bias] = f32s(inputs)?;
        Ok(vec![reference::channel_gate(pooled, fc1_weight, fc1_bias, fc2_weight, fc2_bias).into()])
    }

    /// Each layer is a sum of products, off by its own roundings and by what the layer before left;
    /// ReLU does not enlarge that, and the logistic function divides it by 4. Two vectors go
    /// through, so every layer counts twice. The first layer's sums are dealt out to `LANES`
    /// invocations.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        let sizes = inputs.iter().map(|v| magnitude(v)).collect::<Result<Vec<_>>>()?;
        let [hidden, channels] = [0, 1].map(|i| sizes[1].dims()[i]);
        let at = |t: usize, i: usize| f64::from(sizes[t].data()[i]);
        // A bias, and the sum of the two vectors.
        let first = SumOrder::dealt(channels, LANES).and(2);
        let second = SumOrder::serial(hidden).and(1);
        // For each hidden unit: bound of its absolute value, and of its error.
        let units: Vec<(f64, f64)> = (0..hidden)
            .map(|r| {
                let dot = |c| at(1, r * channels + c) * (at(0, c) + at(0, channels + c));
                let size = (0..channels).map(dot).sum::<f64>() + 2.0 * at(2, r);
                (size, first.error(size))
            })
            .collect();
        let each = (0..channels).map(|c| {
            let weights = (0..hidden).map(|r| at(3, c * hidden + r));
            let (mut size, mut error) = (2.0 * at(4, c), 0.0);
            for (w, unit) in weights.zip(&units) {
                size += w * unit.0;
                error += w * unit.1;
            }
            sigmoid_error(error + second.error(size))
        });
        Ok(vec![Tolerance::Each(each.collect())])
    }
}

/// The five tensors of an MLP.
fn f32s<'a>(inputs: &[&'a Value]) -> Result<[&'a Tensor; 5]> {
    Ok([inputs[0].f32()?, inputs[1].f32()?, inputs[2].f32()?, inputs[3].f32()?, inputs[4].f32()?])
}

fn build(_params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(ChannelGate))
}

fn cases() -> Vec<Case> {
    // One hidden unit over two channels: average (1, 2), maximum (3, 4), fc1 = (1, −1) + 0.5.
    // f hides relu(1 − 2 + 0.5) = 0 and relu(3 − 4 + 0.5) = 0, so only fc2's bias, twice, is left:
    // sigmoid(0) and sigmoid(2 · ln 3 / 2) = 3/4.
    let half_ln3 = 0.549_306_14;
    let mut cases = vec![
        Case::new(
            "bias twice, by hand",
            ChannelGate,
            vec![
                values([2, 2], &[1.0, 2.0, 3.0, 4.0]),
                values([1, 2], &[1.0, -1.0]),
                values([1], &[0.5]),
                values([2, 1], &[7.0, -7.0]),
                values([2], &[0.0, half_ln3]),
            ],
        )
        .by_hand(vec![values([2], &[0.5, 0.75])]),
        // fc1 = (1, 0) and (0, 1): hidden (1, 2) + (3, 0) after the ReLU of −4 for the maximum.
        // fc2 rows (1, −2) and (1000, 1000): logits 4 − 4 = 0 and 6000, saturated.
        Case::new(
            "ReLU before the sum, saturated, by hand",
            ChannelGate,
            vec![
                values([2, 2], &[1.0, 2.0, 3.0, -4.0]),
                values([2, 2], &[1.0, 0.0, 0.0, 1.0]),
                values([2], &[0.0, 0.0]),
                values([2, 2], &[1.0, -2.0, 1000.0, 1000.0]),
                values([2], &[0.0, 0.0]),
            ],
        )
        .by_hand(vec![values([2], &[0.5, 1.0])]),
        // Before the ReLU, once for each vector: (1 + 1/2) + (2 + 1/2) = 4, times ln 3 / 4.
        Case::new(
            "the first layer's bias by hand",
            ChannelGate,
            vec![
                values([2, 1], &[1.0, 2.0]),
                values([1, 1], &[1.0]),
                values([1], &[0.5]),
                values([1, 1], &[half_ln3 / 2.0]),
                values([1], &[0.0]),
            ],
        )
        .by_hand(vec![values([1], &[0.75])]),
        // sigmoid(±1e4) and of ±1e30: 0 and 1, no NaN.
        Case::new(
            "saturated by hand",
            ChannelGate,
            vec![
                values([2, 4], &[0.0; 8]),
                values([1, 4], &[1.0; 4]),
                values([1], &[0.0]),
                values([4, 1], &[1.0; 4]),
                values([4], &[5e3, -5e3, 1e30, -1e30]),
            ],
        )
        .by_hand(vec![values([4], &[1.0, 0.0, 1.0, 0.0])]),
    ];
    // Half of it twice: sigmoid(±88), (±104), (±1e3).
    cases.push(
        Case::new(
            "±88, ±104, ±1e3 by hand",
            ChannelGate,
            vec![
                values([2, 6], &[0.0; 12]),
                values([1, 6], &[1.0; 6]),
                values([1], &[0.0]),
                values([6, 1], &[1.0; 6]),
                values([6], &[44.0, -44.0, 52.0, -52.0, 5e2, -5e2]),
            ],
        )
        .by_hand(vec![values([6], &[1.0, 6.054_602e-39, 1.0, 0.0, 1.0, 0.0])]),
    );
    let mlp = |seed: u64, channels: usize, hidden: usize, scale: f32| -> Vec<Value> {
        vec![
            random_scaled(seed, [2, channels], scale),
            random(seed + 1, [hidden, channels]).into(),
            random(seed + 2, [hidden]).into(),
            random(seed + 3, [channels, hidden]).into(),
            random(seed + 4, [channels]).into(),
        ]
    };
    let shapes = [
        ("one of everything", 1, 1, 1.0),
        ("as after conv1", 64, 4, 0.1),
        ("as conv5_x", 512, 32, 0.02),
        ("prime sizes", 31, 7, 0.1),
        ("15 hidden units: a pass less one", 17, 15, 0.1),
        ("17 hidden units: a pass and one", 15, 17, 0.1),
        ("255 channels: a workgroup less one", 255, 3, 0.05),
        ("257 channels: a workgroup and one", 257, 5, 0.05),
        ("1024 hidden units", 3, 1024, 0.1),
        ("1e-30", 16, 4, 1e-30),
        ("1e30: saturated", 16, 4, 1e30),
    ];
    for (i, (name, channels, hidden, scale)) in shapes.into_iter().enumerate() {
        cases.push(Case::new(name, ChannelGate, mlp(i as u64 * 10, channels, hidden, scale)));
    }
    // Unit r is r % 4 by the average and 0 by the maximum. One channel sees the last unit alone, which
    // is 3, the other the one before, which is 2: ln 3 / 3 · 3 and ln 3 / 2 · 2.
    let ln3 = 2.0 * half_ln3;
    let rows = Tensor::from_fn([2, 1024], |i| match i {
        1023 => ln3 / 3.0,
        2046 => ln3 / 2.0,
        _ => 0.0,
    });
    let units = Tensor::from_fn([1024, 2], |i| if i % 2 == 0 { (i / 2 % 4) as f32 } else { 0.0 });
    let inputs = vec![
        values([2, 2], &[1.0, 0.0, 0.0, 0.0]),
        units.into(),
        Tensor::<f32>::zeros([1024]).into(),
        rows.into(),
        values([2], &[0.0; 2]),
    ];
    cases.push(
        Case::new("the last of 1024 hidden units by hand", ChannelGate, inputs)
            .by_hand(vec![values([2], &[0.75, 0.75])]),
    );
    for (i, channels) in [64, 128, 256, 512].into_iter().enumerate() {
        let seed = 1000 + i as u64 * 10;
        let hidden = channels / 16;
        let mut inputs: Vec<Value> = vec![
            one_way(seed, [2, channels]).into(),
            one_way(seed + 1, [hidden, channels]).into(),
            one_way_sum(seed + 2, [hidden], channels),
            one_way(seed + 3, [channels, hidden]).into(),
        ];
        // A bias that takes the logits back to where the gate is steep.
        let logits: Vec<f32> = (0..channels)
            .map(|c| {
                let of = |t: usize, i: usize| match &inputs[t] {
                    Value::F32(tensor) => f64::from(tensor.data()[i]),
                    Value::U32(_) => 0.0,
                };
                let unit = |r: usize| {
                    let both = |k| of(0, k) + of(0, channels + k);
                    let dot = (0..channels).map(|k| of(1, r * channels + k) * both(k));
                    dot.sum::<f64>() + 2.0 * of(2, r)
                };
                (0..hidden).map(|r| of(3, c * hidden + r) * unit(r)).sum::<f64>() as f32
            })
            .collect();
        inputs.push(Tensor::from_fn([channels], |c| -logits[c] / 2.0).into());
        let name = format!("{channels} channels, {hidden} hidden units");
        cases.push(Case::new(name, ChannelGate, inputs).in_network());
    }
    cases
}
