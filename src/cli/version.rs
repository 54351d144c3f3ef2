//! What `smr-gpu --version` says.

use std::sync::LazyLock;

/// Features that change what the program can do.
const FEATURES: [(&str, bool); 1] = [("embedded-weights", cfg!(feature = "embedded-weights"))];

/// Version, commit and features. The commit is `SMR_GPU_COMMIT` of the build, which packages set: a build script
/// that asks git would compile everything anew after each commit.
pub(super) fn long() -> &'static str {
    static LONG: LazyLock<String> = LazyLock::new(|| {
        let commit = option_env!("SMR_GPU_COMMIT").map(|commit| format!(" (commit {commit})"));
        let there = FEATURES.iter().filter(|(_, there)| *there);
        let features: Vec<_> = there.map(|(name, _)| *name).collect();
        let features = if features.is_empty() { "none" } else { &features.join(", ") };
        let version = env!("CARGO_PKG_VERSION");
        format!("{version}{}\nfeatures: {features}", commit.unwrap_or_default())
    });
    &LONG
}
