//! Mapping a staging buffer: one wait a run.

use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Instant;

use crate::error::{Error, Result};
use crate::gpu::context::Gpu;

/// Maps `staging`, which `submission` copies to, waits for the device and returns the bytes.
///
/// # Errors
/// [`Error::DeviceLost`], [`Error::Timeout`] past the device's time limit, or [`Error::Driver`] if
/// the map is refused.
pub(super) fn read(
    gpu: &Gpu,
    staging: &wgpu::Buffer,
    bytes: u64,
    submission: wgpu::SubmissionIndex,
    stage: &str,
) -> Result<Vec<u8>> {
    let result = wait(gpu, staging.slice(..bytes), submission, stage);
    // Also after an error: a map that is still pending would make every later submit fail.
    staging.unmap();
    result
}

fn wait(
    gpu: &Gpu,
    slice: wgpu::BufferSlice,
    submission: wgpu::SubmissionIndex,
    stage: &str,
) -> Result<Vec<u8>> {
    let start = Instant::now();
    let timeout = gpu.timeout();
    let timed_out = || Error::Timeout { stage: stage.into(), seconds: timeout.as_secs_f64() };
    let refused = |message: String| {
        // A lost device refuses the submission or the map, and says so in the next poll.
        let _ = gpu.device.poll(wgpu::PollType::Poll);
        match gpu.check_lost() {
            Err(lost) => lost,
            Ok(()) => Error::Driver { stage: stage.into(), message },
        }
    };
    let (sender, receiver) = mpsc::channel();
    slice.map_async(wgpu::MapMode::Read, move |result| {
        // The receiver is gone only if this function returned on a timeout.
        let _ = sender.send(result);
    });
    let polled = gpu
        .device
        .poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: Some(timeout) });
    gpu.check_lost()?;
    match polled {
        Ok(_) => {}
        Err(wgpu::PollError::Timeout) => return Err(timed_out()),
        Err(e) => return Err(refused(e.to_string())),
    }
    // The submission is done, but the callback may be running in another thread's poll.
    match receiver.recv_timeout(timeout.saturating_sub(start.elapsed())) {
        Ok(Ok(())) => {}
        Ok(Err(e)) => return Err(refused(e.to_string())),
        Err(RecvTimeoutError::Timeout) => return Err(timed_out()),
        Err(RecvTimeoutError::Disconnected) => {
            return Err(refused("the map was given up".into()));
        }
    }
    let mapped = slice.get_mapped_range().map_err(|e| refused(e.to_string()))?;
    Ok(mapped.to_vec())
}
