//! The kernels on a GPU, each held to its reference within its bound, a case at a time.

use std::sync::Arc;

use serde::Serialize;
use smr_gpu::internals::engine::gpu::{Gpu, GpuOptions};
use smr_gpu::internals::engine::ops::{Case, OPS};
use smr_gpu::internals::verify::check::{Row, Selection, Target, rows_of};
use smr_gpu::{Error, Precision, Result};
use wasm_bindgen::prelude::*;

use crate::error::{Thrown, thrown};

/// What one kernel made of one case.
#[derive(Serialize)]
struct Checked {
    kernel: &'static str,
    precision: Precision,
    /// Error / bound; null where it has no end.
    share: Option<f64>,
    failures: Vec<String>,
    overflows: Vec<String>,
}

impl From<Row> for Checked {
    fn from(row: Row) -> Self {
        let share = row.share.is_finite().then_some(row.share);
        let Row { kernel, precision, failures, overflows, .. } = row;
        Self { kernel, precision, share, failures, overflows }
    }
}

/// A GPU, and an operation's cases for its kernels.
#[wasm_bindgen]
pub struct Checks {
    target: Target,
    operation: &'static str,
    cases: Vec<Case>,
}

#[wasm_bindgen]
impl Checks {
    /// Opens the GPU.
    pub async fn open() -> Result<Self, Thrown> {
        let gpu: Arc<Gpu> = Gpu::open(GpuOptions::default()).await.map_err(thrown)?;
        Ok(Self { target: Target::Gpu(gpu), operation: "", cases: Vec::new() })
    }

    /// The names of all operations.
    pub fn operations(&self) -> Vec<String> {
        OPS.iter().map(|entry| entry.name.to_owned()).collect()
    }

    /// Takes up an operation: the names of its cases.
    pub fn cases(&mut self, operation: String) -> Result<Vec<String>, Thrown> {
        for entry in Selection::of(&operation).entries().map_err(thrown)? {
            (self.operation, self.cases) = (entry.name, (entry.cases)());
        }
        Ok(self.cases.iter().map(|case| case.name.clone()).collect())
    }

    /// What each kernel that fits makes of the case at this place, in each precision, as JSON.
    pub async fn run(&self, case: usize) -> Result<String, Thrown> {
        let cases = self.cases.get(case..=case).ok_or_else(|| {
            let expected = format!("a place below {}", self.cases.len());
            thrown(Error::param("check", "case", expected, case))
        })?;
        let selection = Selection::default();
        let rows =
            rows_of(&self.target, self.operation, cases, &selection).await.map_err(thrown)?;
        let checked: Vec<Checked> = rows.into_iter().map(Checked::from).collect();
        json(&checked).map_err(thrown)
    }
}

fn json(value: &impl Serialize) -> Result<String> {
    let fail = |e| Error::tensor("check", "result", "a value of JSON", e);
    serde_json::to_string(value).map_err(fail)
}
