//! RW-Net's weight of each scale.

use crate::cpu;
use crate::error::{Error, Result};
use crate::ops::bounds::{SumOrder, magnitude};
use crate::ops::case::{Case, one_way, one_way_sum, random, random_scaled, values};
use crate::ops::channel_gate::{LANES, f32s};
use crate::ops::op::{EPS, Entry, Op, Tolerance, dims, expect};
use crate::ops::params::{Params as Named, Settings};
use crate::shape::{DType, TensorSpec};
use crate::tensor::{Tensor, Value};

/// This operation in [`crate::ops::OPS`].
pub static ENTRY: Entry = Entry {
    name: "scale_weights",
    takes: "pooled [N], fc1_weight [M, N], fc1_bias [M], fc2_weight [K, M], fc2_bias [K]",
    gives: "output [K]",
    params: &[],
    build,
    cases,
};

/// RW-Net's MLP: `softmax(fc2(relu(fc1(pooled))))`.
///
/// Inputs: `pooled [N]`, the scales' averages one after the other, `fc1_weight [M, N]`,
/// `fc1_bias [M]`, `fc2_weight [K, M]`, `fc2_bias [K]`; M at most 1024, K at most 256. Output:
/// `output [K]`.
#[derive(Clone, Copy, Debug, Default)]
pub struct ScaleWeights;

impl Op for ScaleWeights {
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
        let [length] = dims(name, "pooled", &inputs[0], DType::F32)?;
        let [hidden, columns] = dims(name, "fc1_weight", &inputs[1], DType::F32)?;
        if columns != length || hidden * columns == 0 {
            let expected = format!("[M, {length}] without a zero");
            return Err(Error::tensor(name, "fc1_weight", expected, &inputs[1]));
        }
        expect(name, "fc1_bias", &TensorSpec::f32([hidden]), &inputs[2])?;
        let [scales, columns] = dims(name, "fc2_weight", &inputs[3], DType::F32)?;
        if columns != hidden || scales == 0 {
            let expected = format!("[K, {hidden}] without a zero");
            return Err(Error::tensor(name, "fc2_weight", expected, &inputs[3]));
        }
        expect(name, "fc2_bias", &TensorSpec::f32([scales]), &inputs[4])?;
        Ok(vec![TensorSpec::f32([scales])])
    }

    fn compute(&self, inputs: &[&Value], _specs: &[TensorSpec]) -> Result<Vec<Value>> {
        let [pooled, fc1_weight, fc1_bias, fc2_weight, fc2_bias] = f32s(inputs)?;
        Ok(vec![cpu::scale_weights(pooled, fc1_weight, fc1_bias, fc2_weight, fc2_bias).into()])
    }

    /// Logits are off as in the channel gate. If each is off by at most δ, a softmax weight is off by
    /// at most δ/2: it is the logistic function of one logit against the others' log-sum, which
    /// shifts by 2δ, around a slope of 1/4. The exponential of d = z − max is 3 + 2|d| ULP off and
    /// |d|·EPS by the subtraction, but weighs exp(d), and |d|·exp(d) < 0.37: 8 EPS above the fraction
    /// and 6 + 2K below it. The sum adds K, the division 5.
    fn tolerance(&self, inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
        let sizes = inputs.iter().map(|v| magnitude(v)).collect::<Result<Vec<_>>>()?;
        let [hidden, length] = [0, 1].map(|i| sizes[1].dims()[i]);
        let scales = sizes[3].dims()[0];
        let at = |t: usize, i: usize| f64::from(sizes[t].data()[i]);
        let first = SumOrder::dealt(length, LANES).and(1);
        let second = SumOrder::serial(hidden).and(1);
        let units: Vec<(f64, f64)> = (0..hidden)
            .map(|m| {
                let dot = |n| at(1, m * length + n) * at(0, n);
                let size = (0..length).map(dot).sum::<f64>() + at(2, m);
                (size, first.error(size))
            })
            .collect();
        let logit_error = |k: usize| {
            let (mut size, mut error) = (at(4, k), 0.0);
            for (m, unit) in units.iter().enumerate() {
                size += at(3, k * hidden + m) * unit.0;
                error += at(3, k * hidden + m) * unit.1;
            }
            error + second.error(size)
        };
        let worst = (0..scales).map(logit_error).fold(0.0, f64::max);
        let rounding = (21 + 3 * scales) as f64 * EPS + f64::from(f32::MIN_POSITIVE);
        Ok(vec![Tolerance::Uniform(worst / 2.0 + rounding)])
    }
}

fn build(_params: &mut Named, _present: &[&str]) -> Result<Box<dyn Op>> {
    Ok(Box::new(ScaleWeights))
}

fn cases() -> Vec<Case> {
    let ln2 = std::f32::consts::LN_2;
    // A pass-through: one input, hidden units relu(x) and relu(−x), a logit each and a bias.
    let logits = |x: f32, rows: &[f32], bias: &[f32]| -> Vec<Value> {
        vec![
            values([1], &[x]),
            values([2, 1], &[1.0, -1.0]),
            values([2], &[0.0, 0.0]),
            values([bias.len(), 2], rows),
            values([bias.len()], bias),
        ]
    };
    let mut cases = vec![
        // x = −3 hides (0, 3); rows (5, 0), (5, 0), (5, 0) see only the zero, so the logits are
        // ln 1, ln 2 and ln 1: weights 1/4, 1/2, 1/4. Without the ReLU x would show.
        Case::new(
            "ReLU and softmax by hand",
            ScaleWeights,
            logits(-3.0, &[5.0, 0.0, 5.0, 0.0, 5.0, 0.0], &[0.0, ln2, 0.0]),
        )
        .by_hand(vec![values([3], &[0.25, 0.5, 0.25])]),
        // x = 2 hides (2, 0): logits 1·2 = 2 and −1·2 + 4 + ln 2 = 2 + ln 2, weights 1 : 2.
        Case::new(
            "two layers by hand",
            ScaleWeights,
            logits(2.0, &[1.0, 9.0, -1.0, 9.0], &[0.0, 4.0 + ln2]),
        )
        .by_hand(vec![values([2], &[1.0 / 3.0, 2.0 / 3.0])]),
        // x = 1 hides (1 + 1/2, −1 + 2): logits ln 2 / 1.5 · 1.5, ln 5 · 1 and 0, weights 2 : 5 : 1.
        Case::new(
            "the first layer's bias by hand",
            ScaleWeights,
            vec![
                values([1], &[1.0]),
                values([2, 1], &[1.0, -1.0]),
                values([2], &[0.5, 2.0]),
                values([3, 2], &[ln2 / 1.5, 0.0, 0.0, 5f32.ln(), 0.0, 0.0]),
                values([3], &[0.0; 3]),
            ],
        )
        .by_hand(vec![values([3], &[0.25, 0.625, 0.125])]),
        Case::new(
            "logits of ±1e4 by hand",
            ScaleWeights,
            logits(0.0, &[0.0; 6], &[1e4, -1e4, 0.0]),
        )
        .by_hand(vec![values([3], &[1.0, 0.0, 0.0])]),
        // e^-80 is 1.8e-35.
        Case::new(
            "one scale by e^80, by hand",
            ScaleWeights,
            logits(0.0, &[0.0; 6], &[0.0, 80.0, 0.0]),
        )
        .by_hand(vec![values([3], &[1.804_851_4e-35, 1.0, 1.804_851_4e-35])]),
        Case::new(
            "equal logits of -1e30 by hand",
            ScaleWeights,
            logits(0.0, &[0.0; 4], &[-1e30, -1e30]),
        )
        .by_hand(vec![values([2], &[0.5, 0.5])]),
    ];
    let mlp = |seed: u64, length: usize, hidden: usize, scales: usize, scale: f32| {
        vec![
            random_scaled(seed, [length], scale),
            random_scaled(seed + 1, [hidden, length], 0.2),
            random(seed + 2, [hidden]).into(),
            random_scaled(seed + 3, [scales, hidden], 0.2),
            random(seed + 4, [scales]).into(),
        ]
    };
    let shapes = [
        ("one of everything", 1, 1, 1, 1.0),
        ("as in the network", 192, 64, 3, 1.0),
        ("prime sizes", 61, 31, 5, 1.0),
        ("15 hidden units: a pass less one", 17, 15, 2, 1.0),
        ("17 hidden units: a pass and one", 15, 17, 2, 1.0),
        ("255 scales: a workgroup less one", 7, 3, 255, 1.0),
        ("256 scales: a workgroup", 7, 3, 256, 1.0),
        ("1024 hidden units", 3, 1024, 3, 0.1),
        ("1e-30", 16, 4, 3, 1e-30),
    ];
    for (i, (name, length, hidden, scales, scale)) in shapes.into_iter().enumerate() {
        let inputs = mlp(i as u64 * 10, length, hidden, scales, scale);
        cases.push(Case::new(name, ScaleWeights, inputs));
    }
    // Unit r is r % 4. One scale sees the last unit alone, which is 3, one the unit before, which is 2:
    // the logits are ln 2 / 3 · 3, ln 5 / 2 · 2 and 0, the weights 2 : 5 : 1.
    let rows = Tensor::from_fn([3, 1024], |i| match i {
        1023 => ln2 / 3.0,
        2046 => 5f32.ln() / 2.0,
        _ => 0.0,
    });
    let inputs = vec![
        values([1], &[1.0]),
        Tensor::from_fn([1024, 1], |r| (r % 4) as f32).into(),
        Tensor::<f32>::zeros([1024]).into(),
        rows.into(),
        values([3], &[0.0; 3]),
    ];
    cases.push(
        Case::new("the last of 1024 hidden units by hand", ScaleWeights, inputs)
            .by_hand(vec![values([3], &[0.25, 0.625, 0.125])]),
    );
    // Rows of the second layer of different size, so that an error does not shift all logits alike,
    // and a bias that brings the logits together again: all weights are near one third.
    let mut rows = one_way(1003, [3, 64]);
    rows.data_mut().iter_mut().enumerate().for_each(|(i, w)| *w /= [1.0, 4.0, 16.0][i / 64]);
    let (pooled, fc1) = (one_way(1000, [768]), one_way(1001, [64, 768]));
    let bias = one_way_sum(1002, [64], 768);
    let bias_of = |m: usize| match &bias {
        Value::F32(tensor) => f64::from(tensor.data()[m]),
        Value::U32(_) => 0.0,
    };
    let at = |tensor: &Tensor, i: usize| f64::from(tensor.data()[i]);
    let unit = |m: usize| {
        let dot = (0..768).map(|n| at(&fc1, m * 768 + n) * at(&pooled, n));
        dot.sum::<f64>() + bias_of(m)
    };
    let units: Vec<f64> = (0..64).map(unit).collect();
    let logit = |k: usize| (0..64).map(|m| at(&rows, k * 64 + m) * units[m]).sum::<f64>();
    let back = Tensor::from_fn([3], |k| -logit(k) as f32);
    let inputs = vec![pooled.into(), fc1.into(), bias.clone(), rows.into(), back.into()];
    cases.push(Case::new("the network's, in balance", ScaleWeights, inputs).in_network());
    cases
}
