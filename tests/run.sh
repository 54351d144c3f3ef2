#!/usr/bin/env bash
# Runs every check, on a GPU or on a software adapter. Where no Vulkan adapter is found it installs
# Mesa's (lavapipe) by apt, as root or with sudo. Without an adapter it fails: nothing is skipped.
# Usage: tests/run.sh [quick]
# `quick` is for while one writes: format, lints, the unit tests, every kernel's cases by hand, the
# sample pictures, the layout.
set -euo pipefail
cd "$(dirname "$0")/.."

case "${1:-}" in
"" | quick) ;;
*)
    echo "expected nothing or \`quick\`, got $1"
    exit 2
    ;;
esac

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

smr_gpu=${CARGO_TARGET_DIR:-target}/release/smr-gpu

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

# The other workspaces' locks name what this crate depends on, too.
locks() {
    local lock
    for lock in bindings/*/Cargo.lock fuzz/Cargo.lock; do
        cargo metadata --locked --format-version 1 --manifest-path "${lock%lock}toml" >/dev/null
    done
}

# What crates.io takes, in bytes.
most_packed=10000000
package() {
    local size
    cargo package --locked --quiet --no-verify --allow-dirty
    size=$(cat "${CARGO_TARGET_DIR:-target}"/package/smr-gpu-*.crate | wc -c)
    echo "$size bytes packed, at most $most_packed"
    [ "$size" -le "$most_packed" ]
}

if [ "${1:-}" = quick ]; then
    # Builds again what a change touches, and no more.
    export CARGO_INCREMENTAL=1
    tests=(--lib --bins --test detect --test layout --test ops)
    step format cargo fmt --check
    step build cargo test --locked --release "${tests[@]}" --no-run
    step adapter have_adapter
    step clippy cargo clippy --locked --release --all-targets -- -D warnings
    step unit cargo test --locked --release --lib --bins
    step layout cargo test --locked --release --test layout
    step kernels cargo test --locked --release --test ops by_hand
    step pictures cargo test --locked --release --test detect samples
    exit
fi

# Nothing is built a second time here.
export CARGO_INCREMENTAL=0

# The units of code are tested with overflow checks and debug assertions in this crate, and so is the program;
# what it depends on is built already. One codegen unit is built in less time than sixteen.
own=profile.release.package.smr-gpu
checks=(
    --config "$own.overflow-checks=true"
    --config "$own.debug-assertions=true"
    --config "$own.codegen-units=1"
)
# All other tests, the program's again, run on what is released; tests/ops.rs has every case that
# `smr-gpu check` has, on the GPU and on cores.
released=(--test '*')
step format cargo fmt --check
# With what the tests need, so that nothing is built twice; the program is built with them.
step build cargo test --locked --release "${checks[@]}" --lib --bins --test cli --no-run
step adapter have_adapter
step checked cargo test --locked --release "${checks[@]}" --lib --bins --test cli
# From here on the program is the released one.
step released cargo test --locked --release "${released[@]}" --no-run
step clippy cargo clippy --locked --release --all-targets -- -D warnings
step features features
step crates crates
step locks locks
step package package
RUSTDOCFLAGS="-D warnings" step docs cargo doc --locked --release --no-deps
if command -v cargo-deny >/dev/null; then
    step deny cargo deny --locked check bans licenses sources
fi
# What of training needs nothing but Python itself; weights/training/run.sh has the rest.
labels() {
    (cd weights/training && python3 -m unittest -q tests/test_labels.py)
}
if command -v python3 >/dev/null; then
    step labels labels
fi
# Examples are no tests: clippy has compiled them.
step tests cargo test --locked --release "${released[@]}"
step doctests cargo test --locked --release --doc
