//! Kernels of one dispatch, on planar tensors.

use crate::engine::kernels::{Caps, Dispatch, Io, Kernel, Recording, Work};
use crate::engine::shader::{Shader, Variant};
use crate::error::Result;

/// A kernel that reads and writes planar tensors, in one dispatch for each picture.
#[derive(Debug)]
pub(super) struct Plain {
    /// See [`Kernel::id`].
    pub id: &'static str,
    /// It has one variant.
    pub shader: &'static Shader,
    /// What [`Kernel::record`] appends.
    pub dispatch: fn(&Work, &mut Recording, Io) -> Result<Dispatch>,
}

impl Kernel for Plain {
    fn id(&self) -> &'static str {
        self.id
    }

    fn shaders(&self, _caps: &Caps) -> Vec<(&'static Shader, Variant)> {
        vec![(self.shader, Variant::default())]
    }

    fn record(&self, work: &Work, recording: &mut Recording, io: Io) -> Result<()> {
        let dispatch = (self.dispatch)(work, recording, io)?;
        recording.dispatch(dispatch);
        Ok(())
    }
}
