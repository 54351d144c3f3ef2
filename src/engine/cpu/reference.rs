//! Operations that are small, or rare: by their f64 reference.

use crate::engine::shape::{DType, TensorSpec};
use crate::engine::tensor::{Tensor, Value};
use crate::error::Result;

use super::kernel::{Data, Kernel, Layout};

/// A node of a graph, computed by [`crate::engine::ops::Op::reference`].
#[derive(Debug)]
pub(super) struct Reference {
    op: std::sync::Arc<dyn crate::engine::ops::Op>,
    inputs: Vec<TensorSpec>,
}

impl Reference {
    pub fn new(op: std::sync::Arc<dyn crate::engine::ops::Op>, inputs: Vec<TensorSpec>) -> Self {
        Self { op, inputs }
    }
}

impl Kernel for Reference {
    fn input_layout(&self, _index: usize) -> Layout {
        Layout::Planar
    }

    fn output_layout(&self) -> Layout {
        Layout::Planar
    }

    fn run(&self, inputs: &[Data], outputs: &mut [&mut [f32]]) -> Result<()> {
        let values: Result<Vec<Value>> = inputs
            .iter()
            .zip(&self.inputs)
            .map(|(data, spec)| {
                Ok(match (data, spec.dtype) {
                    (Data::F32(data), DType::F32) => {
                        Tensor::new(spec.shape.clone(), data.to_vec())?.into()
                    }
                    (data, _) => Tensor::new(spec.shape.clone(), data.u32()?.to_vec())?.into(),
                })
            })
            .collect();
        let values = values?;
        let results = self.op.reference(&values.iter().collect::<Vec<_>>())?;
        for (result, output) in results.iter().zip(outputs) {
            match result {
                Value::F32(t) => output.copy_from_slice(t.data()),
                Value::U32(t) => output.copy_from_slice(bytemuck::cast_slice(t.data())),
            }
        }
        Ok(())
    }
}
