#!/usr/bin/env bash
# Packs for aarch64 on another Debian machine without rustup, and tries the program there under qemu:
# packaging/aarch64.sh FOLDER. FOLDER keeps what that needs beside this machine's own: rustc and aarch64's std of Debian
# unstable, aarch64's glibc and lavapipe of this Debian release (3 GB). Needs root, and the packages named below.
set -euo pipefail
[ $# = 1 ] || { echo "expected a folder, got $# arguments"; exit 2; }
cd "$(dirname "$0")/.."
target=aarch64-unknown-linux-gnu
for command in aarch64-linux-gnu-gcc:gcc-aarch64-linux-gnu qemu-aarch64:qemu-user debootstrap:debootstrap; do
    command -v "${command%:*}" >/dev/null || { echo "apt-get install ${command#*:}"; exit 1; }
done
mkdir -p "$1"
folder=$(realpath "$1")
system=$folder/system

[ -e "$folder/rust/bin/rustc" ] || bindings/web/toolchain.sh "$folder/rust" libstd-rust-dev:arm64
if [ ! -e "$system/usr/lib/aarch64-linux-gnu/libvulkan_lvp.so" ]; then
    # Nothing is configured: that would need the packages' scripts to run.
    debootstrap --arch=arm64 --foreign --variant=minbase --include=libvulkan1,mesa-vulkan-drivers \
        "$(. /etc/os-release && echo "$VERSION_CODENAME")" "$system"
    for package in "$system"/var/cache/apt/archives/*.deb; do
        dpkg-deb --extract "$package" "$system"
    done
fi

export RUSTC=$folder/rust/bin/rustc
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_LINKER=aarch64-linux-gnu-gcc
export CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER="qemu-aarch64 -L $system"
# The host's own programs, such as build scripts, are built by the same rustc.
packaging/package.sh "$target"

export VK_ICD_FILENAMES=$system/usr/share/vulkan/icd.d/lvp_icd.aarch64.json
smr_gpu() {
    qemu-aarch64 -L "$system" target/packages/smr-gpu-*-$target/bin/smr-gpu "$@"
}
smr_gpu --version
smr_gpu devices
