#!/usr/bin/env bash
# Tests the training package in an environment of its own: types, labels, pictures, the model against
# torchvision, and a tiny run from labels to `smr-gpu detect`. It takes some minutes and, with PyPI's build of
# torch, 6 GB; TRAIN=FOLDER keeps the environment for the next time, and may hold one with another build.
# Usage: weights/training/run.sh [SMR_GPU]; without the program's path it is built.
set -euo pipefail
cd "$(dirname "$0")"

if [ -n "${TRAIN:-}" ]; then
    work=$TRAIN
    mkdir -p "$work"
else
    work=$(mktemp -d)
    trap 'rm -rf "$work"' EXIT
fi
if [ -n "${1:-}" ]; then
    SMR_GPU=$(realpath "$1")
else
    cargo build --locked --release
    SMR_GPU=${CARGO_TARGET_DIR:-$PWD/../../target}/release/smr-gpu
fi
export SMR_GPU
if [ ! -x "$work/bin/python" ]; then
    python3 -m venv "$work"
fi
"$work/bin/pip" install --quiet --editable '.[convert,onnx,experiments,reference,check]'
python=$work/bin/python
started=$SECONDS
"$work/bin/mypy" smr_gpu_train
for test in labels pictures model parts pool other_renderers convert onnx fit guide experiments installation; do
    echo "== $test"
    "$python" "tests/test_$test.py"
done
echo "All tests of the training passed in $((SECONDS - started)) s."
