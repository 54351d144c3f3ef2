#!/usr/bin/env bash
# Checks of the code that run none of it: lints, each feature alone, dependencies, what crates.io takes, documentation.
set -euo pipefail
cd "$(dirname "$0")/.."

cargo clippy --locked --release --all-targets -- -D warnings

# Each feature alone compiles, without what tests bring; none, with the tests that need none.
cargo clippy --locked --release --all-targets --no-default-features -- -D warnings
for feature in image picture cpu embedded-weights serde eval simulator; do
    cargo clippy --locked --release --lib --no-default-features --features "$feature" -- -D warnings
done

# A program that embeds the detector gets few crates with it.
most_crates=75
found=$(cargo tree --locked -e normal --prefix none --no-dedupe --no-default-features | sort -u | wc -l)
echo "$found crates without features, at most $most_crates"
[ "$found" -le "$most_crates" ]

# The other workspaces' locks name what this crate depends on, too.
for lock in bindings/*/Cargo.lock fuzz/Cargo.lock; do
    cargo metadata --locked --format-version 1 --manifest-path "${lock%lock}toml" >/dev/null
done

# What crates.io takes, in bytes.
most_packed=10000000
cargo package --locked --quiet --no-verify --allow-dirty
size=$(cat "${CARGO_TARGET_DIR:-target}"/package/smr-gpu-*.crate | wc -c)
echo "$size bytes packed, at most $most_packed"
[ "$size" -le "$most_packed" ]

RUSTDOCFLAGS="-D warnings" cargo doc --locked --release --no-deps

if command -v cargo-deny >/dev/null; then
    cargo deny --locked check bans licenses sources
fi

# That the C interface fits the library; what the other interfaces use it does too.
cargo clippy --locked --release --manifest-path bindings/c/Cargo.toml -- -D warnings
