#!/usr/bin/env bash
# Builds a binding and runs its tests. Usage: bindings/run.sh python|c
# `python` needs Python 3.11 or newer ($PYTHON, or python3) and Rust; it makes bindings/python/.venv.
# `c` needs Rust and a C compiler with sanitizers ($CC, or cc).
# $SMR_GPU_TEST_DEVICE is the device of its tests: `cpu` by default, `gpu` for an adapter.
set -euo pipefail
cd "$(dirname "$0")/.."

python() {
    local folder=bindings/python
    local venv=$folder/.venv
    "${PYTHON:-python3}" -m venv "$venv"
    "$venv/bin/pip" install --quiet --requirement "$folder/requirements.txt"
    # The wheel's tag says which Linux it runs on; maturin checks it against what the library needs.
    rm -rf "$folder/target/wheels"
    (cd "$folder" && .venv/bin/maturin build --release --locked --interpreter .venv/bin/python)
    "$venv/bin/pip" install --quiet --force-reinstall --no-deps "$folder"/target/wheels/*.whl
    ls -l "$folder"/target/wheels
    # What the tests hold the package to.
    if [ -z "${SMR_GPU_PROGRAM:-}" ]; then
        cargo build --locked --release --bin smr-gpu
        export SMR_GPU_PROGRAM=${CARGO_TARGET_DIR:-$PWD/target}/release/smr-gpu
    fi
    "$venv/bin/python" -m pytest "$folder"
}

c() {
    # Tests link to what is built here.
    (cd bindings/c && cargo build --locked && cargo test --locked)
}

case "${1:-}" in
python) python ;;
c) c ;;
*)
    echo "expected \`python\` or \`c\`, got ${1:-nothing}"
    exit 2
    ;;
esac
