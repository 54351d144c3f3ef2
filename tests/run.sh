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
lints=""

summary() {
    local status=$?
    if [ -n "$lints" ]; then
        kill "$lints" 2>/dev/null || true
    fi
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

# Units of code are tested with overflow checks and debug assertions in this crate. All other tests, the program's among
# them, run on what is released; tests/ops.rs has every case that `smr-gpu check` has, on the GPU and on cores.
own=profile.release.package.smr-gpu
checks=(--config "$own.overflow-checks=true" --config "$own.debug-assertions=true" --lib)
released=(--bins --test '*')
step format cargo fmt --check
# Checks that tests do not wait for: in a folder of their own, with the time that building and testing leave.
beside=${CARGO_TARGET_DIR:-target}/lints
mkdir -p "$beside"
CARGO_TARGET_DIR=$beside nice tests/lints.sh >"$beside/log" 2>&1 &
lints=$!
step build cargo test --locked --release "${released[@]}" --no-run
step adapter have_adapter
step units cargo test --locked --release "${checks[@]}"
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
linted() {
    local status=0
    wait "$lints" || status=$?
    lints=""
    cat "$beside/log"
    return "$status"
}
step lints linted
