#!/usr/bin/env bash
# Builds the C library and installs it: bindings/c/install.sh [PREFIX], by default /usr/local.
set -euo pipefail
cd "$(dirname "$0")"
prefix=${1:-/usr/local}
mkdir -p "$prefix"
prefix=$(cd "$prefix" && pwd)
cargo build --release --locked
built=${CARGO_TARGET_DIR:-target}/release
version=$(sed -n 's/^version = "\(.*\)"$/\1/p' Cargo.toml | head -1)
install -D -m 644 include/smr_gpu.h "$prefix/include/smr_gpu.h"
install -D -m 755 "$built/libsmr_gpu.so" "$prefix/lib/libsmr_gpu.so"
install -D -m 644 "$built/libsmr_gpu.a" "$prefix/lib/libsmr_gpu.a"
install -D -m 644 cmake/FindSmrGpu.cmake "$prefix/share/cmake/Modules/FindSmrGpu.cmake"
mkdir -p "$prefix/lib/pkgconfig"
sed "s|@prefix@|$prefix|; s|@version@|$version|" smr_gpu.pc.in > "$prefix/lib/pkgconfig/smr_gpu.pc"
