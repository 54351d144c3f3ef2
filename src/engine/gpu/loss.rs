//! [`Loss`]: whether a device is gone, and why.

use std::sync::{Arc, Mutex};

use crate::engine::lock::lock;

/// Why a device is gone, once it is. Clones are one and the same.
#[derive(Clone, Debug, Default)]
pub(super) struct Loss(Arc<Mutex<Option<String>>>);

impl Loss {
    /// The first to say so is believed.
    pub fn tell(&self, message: String) {
        lock(&self.0).get_or_insert(message);
    }

    pub fn get(&self) -> Option<String> {
        lock(&self.0).clone()
    }

    /// Probes whether `device` still is, and tells if not. It reports its loss when all work is done that it
    /// had, to a handler that may be another's, and until then takes every call and does nothing: so this makes
    /// a buffer and sees whether there is one.
    pub async fn probe(&self, device: &wgpu::Device) {
        let (is_there, is_full) = make(device);
        if !is_there && is_full.await.is_none() {
            self.tell("it takes no more calls".into());
        }
    }
}

/// Whether `device` makes a buffer, and whether it had no memory for one.
fn make(device: &wgpu::Device) -> (bool, impl Future<Output = Option<wgpu::Error>>) {
    let memory = device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
    let validation = device.push_error_scope(wgpu::ErrorFilter::Validation);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: 4,
        usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
        mapped_at_creation: true,
    });
    let is_there = buffer.slice(..).get_mapped_range().is_ok();
    drop(validation.pop());
    (is_there, memory.pop())
}
