//! Folders of the user.

use std::path::PathBuf;

use etcetera::BaseStrategy;

/// Names the folder of the choices where the system's convention does not.
pub(super) const CACHE_VARIABLE: &str = "SMR_GPU_CACHE";

/// Where measured choices of kernels are kept.
pub(super) fn tuned() -> Option<PathBuf> {
    if let Some(folder) = std::env::var_os(CACHE_VARIABLE).filter(|v| !v.is_empty()) {
        return Some(folder.into());
    }
    let user = etcetera::base_strategy::choose_native_strategy().ok()?;
    Some(user.cache_dir().join("smr-gpu"))
}
