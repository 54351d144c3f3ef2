#!/usr/bin/env bash
# Compiles every shader in every variant with Tint, the compiler of Chrome and Dawn, which is stricter
# than naga. Takes Dawn from npm (`webgpu`) into a folder that is removed afterwards; needs Node 20 or
# newer and no GPU.
set -euo pipefail
cd "$(dirname "$0")/.."

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cargo run --locked --release --quiet --example shaders -- "$folder/shaders"
cp tests/tint.mjs "$folder"
cd "$folder"
npm install --silent --no-audit --no-fund --ignore-scripts --prefix "$folder" webgpu@0.6.2
node tint.mjs "$folder/shaders"
