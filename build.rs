//! Tells the program what `--version` says of it.

use std::path::Path;
use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let commit = commit().map_or_else(String::new, |commit| format!(" (commit {commit})"));
    println!("cargo::rustc-env=SMR_GPU_COMMIT={commit}");
    let features = std::env::var("CARGO_CFG_FEATURE").unwrap_or_default();
    let features: Vec<&str> = features.split(',').filter(|name| *name != "default").collect();
    println!("cargo::rustc-env=SMR_GPU_FEATURES={}", features.join(", "));
}

/// The commit of the checkout, if the sources are one. A crate's may lie within somebody else's.
fn commit() -> Option<String> {
    if !Path::new(".git").exists() {
        return None;
    }
    // Commits and checkouts write to it.
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"])
        && Path::new(&log).exists()
    {
        println!("cargo::rerun-if-changed={log}");
    }
    git(&["rev-parse", "--short=12", "HEAD"])
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned())
}
