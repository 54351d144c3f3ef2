//! What every operation offers: the trait that binds a shader to its CPU reference.

use std::any::Any;
use std::fmt::Debug;
use std::sync::Arc;

use crate::engine::ops::params::{Param, Params, Settings};
use crate::engine::precision::Precision;
use crate::engine::shape::TensorSpec;
use crate::engine::tensor::Value;
use crate::error::{Error, Result};

/// One operation with its parameters.
pub trait Op: Any + Debug + Send + Sync {
    /// The operation's entry in [`crate::engine::ops::OPS`].
    fn entry(&self) -> &'static Entry;

    /// Stem of the operation's files.
    fn name(&self) -> &'static str {
        self.entry().name
    }

    /// The value of each of the entry's parameters, in their order.
    fn settings(&self) -> Settings;

    /// Names of the inputs that this instance takes, in order.
    fn inputs(&self) -> Vec<&'static str>;

    /// Names of the outputs, in order.
    fn outputs(&self) -> Vec<&'static str>;

    /// Checks the parameters and the inputs' shapes and types, and tells the outputs'.
    ///
    /// # Errors
    /// [`Error::Param`] or [`Error::Tensor`] that names what does not fit, [`Error::Capacity`] for
    /// a tensor whose elements a u32 does not count: so shaders count.
    fn infer(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
        check_settings(self)?;
        let names = self.inputs();
        expect_inputs(self.name(), &names, inputs.len())?;
        for (name, spec) in names.into_iter().zip(inputs) {
            check_size(self.name(), name, spec)?;
        }
        let outputs = self.shapes(inputs)?;
        for (name, spec) in self.outputs().into_iter().zip(&outputs) {
            check_size(self.name(), name, spec)?;
        }
        Ok(outputs)
    }

    /// What [`Op::infer`] leaves to the operation: `inputs` are as many as it names, and its
    /// parameters are each in its range. Products of a tensor's dimensions fit in a u32.
    ///
    /// # Errors
    /// As [`Op::infer`].
    fn shapes(&self, inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>>;

    /// Checks values that shader and reference take on trust; `inputs` have shapes that `infer`
    /// accepted.
    ///
    /// # Errors
    /// [`Error::Tensor`] or [`Error::Capacity`].
    fn check_values(&self, _inputs: &[&Value]) -> Result<()> {
        Ok(())
    }

    /// All checks of the inputs, shapes and values, and the outputs' shapes: whoever runs an operation
    /// comes through here, on the device as on the CPU.
    ///
    /// # Errors
    /// As [`Op::infer`] and [`Op::check_values`].
    fn check(&self, inputs: &[&Value]) -> Result<Vec<TensorSpec>> {
        let specs: Vec<_> = inputs.iter().map(|v| v.spec()).collect();
        let outputs = self.infer(&specs)?;
        self.check_values(inputs)?;
        Ok(outputs)
    }

    /// The same as the shader on the CPU, from the definition, with f64 sums.
    ///
    /// # Errors
    /// As [`Op::check`].
    fn reference(&self, inputs: &[&Value]) -> Result<Vec<Value>> {
        let outputs = self.check(inputs)?;
        self.compute(inputs, &outputs)
    }

    /// What [`Op::reference`] leaves to the operation: `inputs` passed [`Op::check`], which tells the
    /// `outputs`.
    ///
    /// # Errors
    /// [`Error::Capacity`] for what takes more memory than the outputs let expect; none else that a checked
    /// input brings about.
    fn compute(&self, inputs: &[&Value], outputs: &[TensorSpec]) -> Result<Vec<Value>>;

    /// How far the shader's outputs may be from the reference's: a bound with a reason, by output.
    ///
    /// # Errors
    /// As [`Op::infer`].
    fn tolerance(&self, inputs: &[&Value], reference: &[Value]) -> Result<Vec<Tolerance>>;

    /// Whether the errors are the roundings of sums and products alone: each falls to either side, so
    /// that they cancel over a tensor. What stays the same in every element is then no rounding.
    fn unbiased(&self) -> bool {
        false
    }

    /// Multiplications that its definition asks for, each with an addition, where they are what it
    /// costs: those of convolutions and layers.
    fn multiply_adds(&self, _inputs: &[TensorSpec], _outputs: &[TensorSpec]) -> u64 {
        0
    }

    /// How many leading elements of each output are defined, where a count on the device decides;
    /// what lies behind them is neither written nor compared.
    fn defined(&self, reference: &[&Value], _inputs: &[&Value]) -> Vec<usize> {
        reference.iter().map(|v| v.spec().shape.elements()).collect()
    }
}

/// How far one output may be from the reference's.
#[derive(Clone, Debug, PartialEq)]
pub enum Tolerance {
    /// Equal bits: indices, counts, copies.
    Exact,
    /// The same absolute bound for each element.
    Uniform(f64),
    /// An absolute bound for each element.
    Each(Vec<f64>),
}

impl Tolerance {
    /// The bound of element `i`.
    pub fn limit(&self, i: usize) -> f64 {
        match self {
            Self::Exact => 0.0,
            Self::Uniform(bound) => *bound,
            Self::Each(bounds) => bounds[i],
        }
    }

    /// The bound of what is stored in `precision`, for a `reference` that is not. Where bits count, they
    /// are those of the reference rounded to the nearest.
    pub(crate) fn stored(self, reference: &Value, precision: Precision) -> Self {
        let Value::F32(reference) = reference else { return self };
        if precision == Precision::F32 {
            return self;
        }
        let rounded = precision.decode(&precision.encode(reference.data()));
        let limits = reference.data().iter().zip(rounded).enumerate();
        let limits = limits.map(|(i, (x, rounded))| match (f64::from(*x), &self) {
            // An infinity less itself would be no bound.
            (x, Self::Exact) if f64::from(rounded) == x => 0.0,
            (x, Self::Exact) => (f64::from(rounded) - x).abs(),
            (x, own) => precision.stored_error(x, own.limit(i)),
        });
        Self::Each(limits.collect())
    }

    /// The error of element `i` and the most that it may be; an error that is not a number is above
    /// every bound, but for one that is infinite of a finite reference.
    pub fn judge(&self, got: &Value, want: &Value, i: usize) -> (f64, f64) {
        let limit = self.limit(i);
        match (got, want) {
            (Value::F32(got), Value::F32(want)) => {
                let (got, want) = (got.data()[i], want.data()[i]);
                // A NaN among the inputs leaves no bound either, but must stay one.
                let both_nan = got.is_nan() && want.is_nan();
                let error = match got.to_bits() == want.to_bits() {
                    true => 0.0,
                    // −0 is not 0 where bits count.
                    false if *self == Self::Exact => f64::INFINITY,
                    false if got == want || both_nan => 0.0,
                    // What overflows on its way to a sum may end as infinity less infinity.
                    false if got.is_nan() && want.is_finite() && limit == f64::INFINITY => limit,
                    false => (f64::from(got) - f64::from(want)).abs(),
                };
                (error, if both_nan { 0.0 } else { limit })
            }
            (Value::U32(got), Value::U32(want)) => {
                (f64::from(got.data()[i].abs_diff(want.data()[i])), 0.0)
            }
            _ => (f64::INFINITY, 0.0),
        }
    }
}

/// Unit roundoff of f32: half the distance from 1 to the next float.
pub const EPS: f64 = f32::EPSILON as f64 / 2.0;

/// Builds an operation from its parameters and the names of the tensors that are present.
pub type Build = fn(&mut Params, &[&str]) -> Result<Box<dyn Op>>;

/// An operation's entry in [`crate::engine::ops::OPS`].
#[derive(Debug)]
pub struct Entry {
    /// Stem of the operation's files.
    pub name: &'static str,
    /// Its inputs with their shapes (f32 where nothing else is said), for people.
    pub takes: &'static str,
    /// Its outputs, likewise.
    pub gives: &'static str,
    /// Its parameters with their ranges; [`Entry::build`] takes them but those by tensors.
    pub params: &'static [Param],
    /// Builds the operation for a command line.
    pub build: Build,
    /// The cases that every implementation of it must pass.
    pub cases: fn() -> Vec<Case>,
}

/// Checks that each parameter is declared, and in its range.
fn check_settings(op: &(impl Op + ?Sized)) -> Result<()> {
    let entry = op.entry();
    for (name, setting) in op.settings() {
        let declared = entry.params.iter().find(|p| p.name == name);
        let expected = declared.map_or("a declared parameter".into(), |p| p.range.to_string());
        if !declared.is_some_and(|p| p.range.admits(&setting)) {
            return Err(Error::param(entry.name, name, expected, setting));
        }
    }
    Ok(())
}

/// Checks that as many inputs came as the operation names.
fn expect_inputs(op: &str, names: &[&str], got: usize) -> Result<()> {
    if names.len() != got {
        return Err(Error::tensor(op, &names.join(", "), names.len(), got));
    }
    Ok(())
}

/// Checks that a u32 counts a tensor's elements, and any part of its dimensions where one is zero.
fn check_size(op: &str, tensor: &str, spec: &TensorSpec) -> Result<()> {
    let elements = spec.shape.0.iter().fold(1u64, |n, d| n.saturating_mul((*d).max(1) as u64));
    if elements > u64::from(u32::MAX) {
        let what = format!("{op}: elements of `{tensor}`");
        return Err(Error::Capacity { what, needed: elements, available: u32::MAX.into() });
    }
    Ok(())
}

/// The dimensions of `spec` if it has rank `N` and this type.
///
/// # Errors
/// [`Error::Tensor`] that names the operation and the tensor.
pub fn dims<const N: usize>(
    op: &str,
    tensor: &str,
    spec: &TensorSpec,
    dtype: crate::engine::shape::DType,
) -> Result<[usize; N]> {
    <[usize; N]>::try_from(spec.shape.0.as_slice())
        .ok()
        .filter(|_| spec.dtype == dtype)
        .ok_or_else(|| Error::tensor(op, tensor, format!("{dtype} of rank {N}"), spec))
}

/// Checks a tensor's whole spec.
///
/// # Errors
/// [`Error::Tensor`] that names the operation and the tensor.
pub fn expect(op: &str, tensor: &str, expected: &TensorSpec, got: &TensorSpec) -> Result<()> {
    if expected != got {
        return Err(Error::tensor(op, tensor, expected, got));
    }
    Ok(())
}

/// The dimensions of a feature map `[C, H, W]`, of which none may be zero.
///
/// # Errors
/// [`Error::Tensor`] that names the operation and the tensor.
pub fn map_dims(op: &str, tensor: &str, spec: &TensorSpec) -> Result<[usize; 3]> {
    let got = dims(op, tensor, spec, crate::engine::shape::DType::F32)?;
    if got.contains(&0) {
        return Err(Error::tensor(op, tensor, "[C, H, W] without a zero", spec));
    }
    Ok(got)
}

/// One input for one operation.
#[derive(Clone, Debug)]
pub struct Case {
    /// What is special about it.
    pub name: String,
    /// The operation with its parameters.
    pub op: Arc<dyn Op>,
    /// Input tensors in the operation's order.
    pub inputs: Vec<Value>,
    /// The outputs, computed by hand from the definition; `None` to trust the reference.
    pub by_hand: Option<Vec<Value>>,
    /// Whether every step of it is exact in f32, so that all outputs must be equal to the bit.
    pub exact: bool,
    /// Whether it has a size of the network, and inputs that f16 cannot hold: rounding any of them
    /// to f16 must fail.
    pub network: bool,
}

impl Case {
    /// A case that is compared with the CPU reference.
    pub fn new(name: impl Into<String>, op: impl Op + 'static, inputs: Vec<Value>) -> Self {
        Self {
            name: name.into(),
            op: Arc::new(op),
            inputs,
            by_hand: None,
            exact: false,
            network: false,
        }
    }

    /// The same with outputs computed by hand, to which the reference is held too.
    pub fn by_hand(mut self, outputs: Vec<Value>) -> Self {
        self.by_hand = Some(outputs);
        self
    }

    /// The same without a bound: nothing in it rounds.
    pub fn exact(mut self) -> Self {
        self.exact = true;
        self
    }

    /// The same as a case of the network's size whose inputs f16 cannot hold.
    pub fn in_network(mut self) -> Self {
        self.network = true;
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An operation that refuses all values, so that it must not come to compute any.
    #[derive(Debug)]
    struct Refuses;

    impl Op for Refuses {
        fn entry(&self) -> &'static Entry {
            crate::engine::ops::OPS[0]
        }

        fn settings(&self) -> Settings {
            Settings::new()
        }

        fn inputs(&self) -> Vec<&'static str> {
            Vec::new()
        }

        fn outputs(&self) -> Vec<&'static str> {
            Vec::new()
        }

        fn shapes(&self, _inputs: &[TensorSpec]) -> Result<Vec<TensorSpec>> {
            Ok(Vec::new())
        }

        fn check_values(&self, _inputs: &[&Value]) -> Result<()> {
            Err(Error::tensor(self.name(), "any", "no value", "a value"))
        }

        fn compute(&self, _inputs: &[&Value], _outputs: &[TensorSpec]) -> Result<Vec<Value>> {
            panic!("computed")
        }

        fn tolerance(&self, _inputs: &[&Value], _reference: &[Value]) -> Result<Vec<Tolerance>> {
            Ok(Vec::new())
        }
    }

    #[test]
    fn a_reference_checks_values_first() {
        let message = Refuses.reference(&[]).expect_err("an error").to_string();
        assert!(message.contains("expected no value"), "{message}");
    }
}
