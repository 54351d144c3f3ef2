//! What `smr-gpu --version` says.

use std::sync::LazyLock;

/// Version, commit and features. The commit is `SMR_GPU_COMMIT` of the build, which packages set: a build script
/// that asks git would compile everything anew after each commit.
pub(super) fn long() -> &'static str {
    static LONG: LazyLock<String> = LazyLock::new(|| {
        let commit = option_env!("SMR_GPU_COMMIT").map(|commit| format!(" (commit {commit})"));
        // The program has all others.
        let features = if cfg!(feature = "embedded-weights") { "embedded-weights" } else { "none" };
        let version = env!("CARGO_PKG_VERSION");
        format!("{version}{}\nfeatures: {features}", commit.unwrap_or_default())
    });
    &LONG
}
