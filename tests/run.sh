#!/usr/bin/env bash
# Runs every check, on a GPU or on a software adapter. Where no Vulkan adapter is found it installs
# Mesa's (lavapipe) by apt, as root or with sudo. Without an adapter it fails: nothing is skipped.
set -euo pipefail
cd "$(dirname "$0")/.."

# What apt brings: the loader and lavapipe.
packages=(libvulkan1 mesa-vulkan-drivers)

steps=()
times=()
current=""
started=$SECONDS

summary() {
    local status=$?
    echo
    for i in "${!steps[@]}"; do
        printf 'ok      %-8s %4d s\n' "${steps[i]}" "${times[i]}"
    done
    if [ "$status" -eq 0 ]; then
        echo "All checks passed in $((SECONDS - started)) s."
    else
        echo "FAILED  ${current:-set-up}"
    fi
}
trap summary EXIT

step() {
    current=$1
    shift
    local begin=$SECONDS
    echo
    echo "== $current: $*"
    "$@"
    steps+=("$current")
    times+=($((SECONDS - begin)))
}

smr_gpu=target/release/smr-gpu

install_adapter() {
    local as_root=()
    if [ "$(id -u)" -ne 0 ]; then
        as_root=(sudo)
    fi
    if ! command -v apt-get >/dev/null; then
        echo "No Vulkan adapter was found. Install a Vulkan loader and driver, on Debian: ${packages[*]}"
        exit 1
    fi
    if [ "$(id -u)" -ne 0 ] && ! sudo -v; then
        echo "No Vulkan adapter was found. As root, run: apt-get install ${packages[*]}"
        exit 1
    fi
    "${as_root[@]}" apt-get update
    DEBIAN_FRONTEND=noninteractive \
        "${as_root[@]}" apt-get install --yes --no-install-recommends "${packages[@]}"
}

have_adapter() {
    if ! "$smr_gpu" devices; then
        install_adapter
        "$smr_gpu" devices
    fi
}

# Each feature alone compiles, and a program that embeds the detector gets few crates with it.
most_crates=75
features() {
    local feature
    # None, with the tests that need none.
    cargo clippy --locked --release --all-targets --no-default-features -- -D warnings
    for feature in image picture cpu embedded-weights serde eval simulator; do
        cargo clippy --locked --release --lib --no-default-features --features "$feature" \
            -- -D warnings
    done
}
crates() {
    local found
    found=$(cargo tree --locked -e normal --prefix none --no-dedupe --no-default-features |
        sort -u | wc -l)
    echo "$found crates without features, at most $most_crates"
    [ "$found" -le "$most_crates" ]
}

# What crates.io takes, in bytes.
most_packed=10000000
package() {
    local size
    cargo package --locked --quiet --no-verify --allow-dirty
    size=$(cat target/package/smr-gpu-*.crate | wc -c)
    echo "$size bytes packed, at most $most_packed"
    [ "$size" -le "$most_packed" ]
}

step format cargo fmt --check
# With what the tests need, so that nothing is built twice; the program is built with them.
step build cargo test --locked --release --tests --no-run
step adapter have_adapter
step clippy cargo clippy --locked --release --all-targets -- -D warnings
step features features
step crates crates
step package package
RUSTDOCFLAGS="-D warnings" step docs cargo doc --locked --release --no-deps
if command -v cargo-deny >/dev/null; then
    step deny cargo deny --locked check bans licenses sources
fi
# Examples are no tests: clippy has compiled them.
step tests cargo test --locked --release --tests
step doctests cargo test --locked --release --doc
# The same code with overflow checks and debug assertions; what it depends on is built already.
step overflow cargo test --locked --release --lib --test cli \
    --config profile.release.package.smr-gpu.overflow-checks=true \
    --config profile.release.package.smr-gpu.debug-assertions=true
# Under its name there is the program with those checks now: put the other one back.
cargo test --locked --release --no-run --test cli
step shaders "$smr_gpu" check --device gpu
