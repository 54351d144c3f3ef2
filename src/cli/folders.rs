//! Folders of the user.

use std::path::PathBuf;

/// Names the folder of the choices where the system's convention does not.
pub(super) const CACHE_VARIABLE: &str = "SMR_GPU_CACHE";

/// Where measured choices of kernels are kept.
pub(super) fn tuned() -> Option<PathBuf> {
    let variable = |name| std::env::var_os(name).filter(|v| !v.is_empty()).map(PathBuf::from);
    if let Some(folder) = variable(CACHE_VARIABLE) {
        return Some(folder);
    }
    let caches = if cfg!(windows) {
        variable("LOCALAPPDATA")
    } else if cfg!(target_os = "macos") {
        std::env::home_dir().map(|home| home.join("Library/Caches"))
    } else {
        variable("XDG_CACHE_HOME").or_else(|| Some(std::env::home_dir()?.join(".cache")))
    };
    caches.map(|folder| folder.join("smr-gpu"))
}
