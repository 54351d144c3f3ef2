#!/usr/bin/env bash
# Builds the npm package in bindings/web/package, and the page with the samples and both networks in
# bindings/web/target/site. Needs Rust, Node 20 or newer, and the target wasm32-unknown-unknown; where Rust has not
# got that, apt, for toolchain.sh.
set -euo pipefail
cd "$(dirname "$0")"

npm ci --silent --no-audit --no-fund
target=wasm32-unknown-unknown
if [ -d "$(rustc --print target-libdir --target "$target")" ]; then
    toolchain=()
else
    bin=$PWD/target/toolchain/bin
    [ -x "$bin/wasm-ld" ] || ./toolchain.sh target/toolchain
    toolchain=(env "RUSTC=$bin/rustc" "CARGO_TARGET_WASM32_UNKNOWN_UNKNOWN_LINKER=$bin/wasm-ld")
fi
"${toolchain[@]}" cargo build --locked --release --target "$target"
module=${CARGO_TARGET_DIR:-target}/$target/release/smr_gpu_web.wasm
rm -rf package/wasm target/site
cargo run --quiet --locked --release --package bindgen -- "$module" package/wasm
module=package/wasm/smr_gpu_web_bg.wasm
npx wasm-opt -Os --strip-debug --strip-producers "$module" -o "$module"
printf '%s: %d bytes, %d with gzip\n' "$module" "$(wc -c <"$module")" "$(gzip -9 <"$module" | wc -c)"

cp ../../LICENSE-* package
mkdir -p target/site/{samples,weights}
cp page/* target/site
cp -r package target/site/smr-gpu
cp ../../samples/*.png target/site/samples
cp ../../weights/*.safetensors target/site/weights
