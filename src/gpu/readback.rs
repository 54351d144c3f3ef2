//! Mapping a staging buffer: one wait a run.

use std::sync::mpsc;

use crate::error::{Error, Result};
use crate::gpu::context::Gpu;

/// Maps `staging`, whose copy was just submitted, waits for the device and returns the bytes.
///
/// # Errors
/// [`Error::DeviceLost`], [`Error::Timeout`] past the device's time limit, or [`Error::Driver`] if
/// the map is refused.
pub(super) fn read(gpu: &Gpu, staging: &wgpu::Buffer, bytes: u64, stage: &str) -> Result<Vec<u8>> {
    let result = wait(gpu, staging, bytes, stage);
    // Also after an error: a map that is still pending would make every later submit fail.
    staging.unmap();
    result
}

fn wait(gpu: &Gpu, staging: &wgpu::Buffer, bytes: u64, stage: &str) -> Result<Vec<u8>> {
    let (sender, receiver) = mpsc::channel();
    let slice = staging.slice(..bytes);
    slice.map_async(wgpu::MapMode::Read, move |result| {
        // The receiver is gone only if this function returned on a timeout.
        let _ = sender.send(result);
    });
    let timeout = gpu.timeout();
    let wait = wgpu::PollType::Wait { submission_index: None, timeout: Some(timeout) };
    let polled = gpu.device.poll(wait);
    gpu.check_lost()?;
    let timed_out = || Error::Timeout { stage: stage.into(), seconds: timeout.as_secs_f64() };
    let refused = |message: String| Error::Driver { stage: stage.into(), message };
    polled.map_err(|e| match e {
        wgpu::PollError::Timeout => timed_out(),
        other => refused(other.to_string()),
    })?;
    match receiver.try_recv() {
        Ok(Ok(())) => {}
        Ok(Err(e)) => {
            // A lost device refuses the map; its callback runs in the next poll.
            let _ = gpu.device.poll(wgpu::PollType::Poll);
            gpu.check_lost()?;
            return Err(refused(e.to_string()));
        }
        Err(_) => return Err(timed_out()),
    }
    let mapped = slice.get_mapped_range().map_err(|e| refused(e.to_string()))?;
    Ok(mapped.to_vec())
}
