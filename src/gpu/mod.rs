//! Everything that touches wgpu: the device, shaders, recordings and their execution.
//!
//! `recording` is device-free: operations write [`Dispatch`]es into a [`Recording`], which
//! [`Plan`] turns once into buffers, pipelines and bind groups, and then runs any number of times.

mod arena;
mod context;
mod executor;
mod readback;
mod recording;
mod shader;

pub use context::{AdapterChoice, AdapterReport, Gpu, GpuOptions, adapters};
pub use executor::{Plan, PlanOptions, Poison, RunOutput, StageTime};
pub use recording::{Dispatch, Grid, MAX_WORKGROUPS, Recording, Role, Stage, TensorId, TensorInfo};
pub(crate) use shader::shader_params;
pub use shader::{EntryReflection, Reflection};
pub use shader::{ParamLayout, Replacement, Shader, reflect, reflect_replaced};
