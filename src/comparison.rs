//! The whole network on a device, stage by stage, against the f64 reference.

use std::collections::HashMap;
use std::time::Duration;

use crate::error::Result;
use crate::gpu::TensorId;
use crate::model::Network;
use crate::tensor::{Tensor, Value};

/// The bound that each stage is held to: the relative L2 error of its float tensors.
pub const STAGE_BOUND: f64 = 1e-5;
/// Candidates that may be among the best on one side alone: two that tie at the cut.
const TIES: usize = 2;

/// One stage on the device and in the reference.
#[derive(Clone, Debug)]
pub struct StageComparison {
    /// Stage name.
    pub stage: String,
    /// Time on the device; `None` where it has no timestamps.
    pub time: Option<Duration>,
    /// Time of the reference.
    pub reference_time: Duration,
    /// Each float tensor of the stage with its relative L2 error, ‖got − want‖ / ‖want‖; infinite
    /// where the two have different numbers of rows. Below a norm of 1, such as that of the scores of
    /// a picture without a snap, the error counts as it is: a score's scale is 1.
    pub tensors: Vec<(String, f64)>,
}

impl StageComparison {
    /// The largest error of the stage's tensors; not a number if one is not.
    pub fn error(&self) -> f64 {
        let errors = self.tensors.iter().map(|(_, e)| *e);
        // Not `max`, which would drop a NaN.
        errors.fold(0.0, |a, b| if a.is_nan() || a >= b { a } else { b })
    }
}

/// ‖got − want‖ / ‖want‖; infinite if one is longer.
pub fn relative_l2(got: &[f32], want: &[f32]) -> f64 {
    let (difference, norm) = norms(got, want);
    if norm == 0.0 { difference } else { difference / norm }
}

/// As [`StageComparison::tensors`] says.
fn stage_error(got: &[f32], want: &[f32]) -> f64 {
    let (difference, norm) = norms(got, want);
    difference / norm.max(1.0)
}

/// ‖got − want‖, infinite if one is longer, and ‖want‖.
fn norms(got: &[f32], want: &[f32]) -> (f64, f64) {
    if got.len() != want.len() {
        return (f64::INFINITY, 1.0);
    }
    let (mut difference, mut norm) = (0.0, 0.0);
    for (g, w) in got.iter().zip(want) {
        let (g, w) = (f64::from(*g), f64::from(*w));
        difference += (g - w).powi(2);
        norm += w * w;
    }
    (difference.sqrt(), norm.sqrt())
}

/// By stage, each float tensor with its error. Both maps hold every computed tensor, cut to its
/// valid rows.
///
/// # Errors
/// [`crate::Error::Tensor`] if a tensor has another type than the graph says.
pub(crate) fn stage_errors(
    network: &Network,
    got: &HashMap<TensorId, Value>,
    want: &HashMap<TensorId, Value>,
) -> Result<Vec<Vec<(String, f64)>>> {
    let graph = &network.graph;
    let rows = shared_candidates(network, got, want)?;
    let error = |id: TensorId| -> Result<Option<(String, f64)>> {
        let (Some(Value::F32(got)), Some(Value::F32(want))) = (got.get(&id), want.get(&id)) else {
            return Ok(None);
        };
        let error = match &rows {
            Some((got_rows, want_rows)) if network.candidates.rows.contains(&id) => {
                stage_error(&pick(got, got_rows), &pick(want, want_rows))
            }
            None if network.candidates.rows.contains(&id) => f64::INFINITY,
            _ => stage_error(got.data(), want.data()),
        };
        Ok(Some((graph.name(id).to_owned(), error)))
    };
    let stages = 0..graph.stages().len();
    stages.map(|s| graph.computed_in(s).filter_map(|id| error(id).transpose()).collect()).collect()
}

/// Rows of the same anchor on both sides, in one order; `None` if more differ than ties explain.
type Rows = Option<(Vec<usize>, Vec<usize>)>;

/// Among a thousand candidates some scores tie to within rounding, and their order may fall either
/// way: so their rows are compared anchor by anchor. Their sorted scores are a tensor too.
fn shared_candidates(
    network: &Network,
    got: &HashMap<TensorId, Value>,
    want: &HashMap<TensorId, Value>,
) -> Result<Rows> {
    let anchors = network.candidates.anchors;
    let (Some(got), Some(want)) = (got.get(&anchors), want.get(&anchors)) else { return Ok(None) };
    let (got, want) = (got.u32()?.data(), want.u32()?.data());
    let places: HashMap<u32, usize> = want.iter().enumerate().map(|(i, a)| (*a, i)).collect();
    let pairs = got.iter().enumerate().filter_map(|(i, a)| Some((i, *places.get(a)?)));
    let (got_rows, want_rows): (Vec<_>, Vec<_>) = pairs.unzip();
    let enough = got_rows.len() + TIES >= got.len().max(want.len());
    Ok(enough.then_some((got_rows, want_rows)))
}

fn pick(tensor: &Tensor, rows: &[usize]) -> Vec<f32> {
    let width: usize = tensor.dims().iter().skip(1).product();
    rows.iter().flat_map(|r| &tensor.data()[r * width..(r + 1) * width]).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn relative_error_by_hand() {
        // ‖(0, 1)‖ / ‖(3, 4)‖.
        assert_eq!(relative_l2(&[3.0, 5.0], &[3.0, 4.0]), 0.2);
        assert_eq!(relative_l2(&[0.0, 2.0], &[0.0, 0.0]), 2.0);
        assert_eq!(relative_l2(&[1.0], &[1.0, 1.0]), f64::INFINITY);
        assert!(relative_l2(&[f32::NAN], &[1.0]).is_nan());
    }

    #[test]
    fn small_tensors_have_absolute_errors() {
        assert_eq!(stage_error(&[3.0, 5.0], &[3.0, 4.0]), 0.2);
        // ‖(0, 0.25)‖, of a norm of 0.5.
        assert_eq!(stage_error(&[0.0, 0.75], &[0.0, 0.5]), 0.25);
        assert_eq!(stage_error(&[0.0, 2.0], &[0.0, 0.0]), 2.0);
    }

    #[test]
    fn a_stage_is_as_good_as_its_worst_tensor() {
        let stage = |errors: &[f64]| StageComparison {
            stage: "s".into(),
            time: None,
            reference_time: Duration::ZERO,
            tensors: errors.iter().map(|e| ("t".into(), *e)).collect(),
        };
        assert_eq!(stage(&[]).error(), 0.0);
        assert_eq!(stage(&[1e-7, 3e-6, 2e-6]).error(), 3e-6);
        assert!(stage(&[1e-7, f64::NAN]).error().is_nan());
        assert!(stage(&[f64::NAN, 1e-7]).error().is_nan());
    }
}
