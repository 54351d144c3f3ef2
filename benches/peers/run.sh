#!/usr/bin/env bash
# Times smr-gpu beside other programs that run the same network: see README.md. What it installs and
# writes lies in a folder that is removed afterwards, or in $PEERS where that names one.
set -euo pipefail
cd "$(dirname "$0")/../.."

if [ -n "${PEERS:-}" ]; then
    work=$PEERS
    mkdir -p "$work"
else
    work=$(mktemp -d)
    trap 'rm -rf "$work"' EXIT
fi
if [ ! -x "$work/venv/bin/python" ]; then
    python3 -m venv "$work/venv"
    "$work/venv/bin/pip" install --quiet ./weights/training \
        -r benches/peers/requirements.txt
fi
cargo build --locked --release --example timed
"$work/venv/bin/python" benches/peers/measure.py --work "$work" "$@"
