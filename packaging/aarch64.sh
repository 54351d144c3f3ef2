#!/usr/bin/env bash
# Packs for aarch64 on another Debian machine without rustup, and tries the program there under qemu:
# packaging/aarch64.sh FOLDER. FOLDER keeps what that needs beside this machine's own: rustc and aarch64's std of Debian
# unstable, aarch64's glibc and lavapipe of this Debian release (3 GB). Needs root, Python 3, this machine's own program,
# $SMR_GPU_PROGRAM or target/release/smr-gpu, and the packages named below. The kernel is told to run aarch64's programs
# by qemu, until it starts again.
set -euo pipefail
[ $# = 1 ] || { echo "expected a folder, got $# arguments"; exit 2; }
cd "$(dirname "$0")/.."
target=aarch64-unknown-linux-gnu
by_qemu=/usr/lib/binfmt.d/qemu-aarch64.conf
for file in /usr/bin/aarch64-linux-gnu-gcc:gcc-aarch64-linux-gnu /usr/sbin/debootstrap:debootstrap \
    $by_qemu:qemu-user-binfmt; do
    [ -e "${file%:*}" ] || { echo "apt-get install ${file#*:}"; exit 1; }
done
# The program looks for drivers in a process of its own: that must go by qemu, too.
binfmt=/proc/sys/fs/binfmt_misc
[ -e $binfmt/register ] || mount -t binfmt_misc none $binfmt
[ -e $binfmt/qemu-aarch64 ] || cat $by_qemu >$binfmt/register
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
export QEMU_LD_PREFIX=$system
# The host's own programs, such as build scripts, are built by the same rustc.
packaging/package.sh "$target"

smr_gpu() {
    VK_ICD_FILENAMES=$system/usr/share/vulkan/icd.d/lvp_icd.aarch64.json \
        target/packages/smr-gpu-*-$target/bin/smr-gpu "$@"
}
smr_gpu --version
for operation in softmax nms top_k decode_detections; do
    smr_gpu check "$operation" --device gpu
done
smr_gpu check linear --device cpu
# The same snaps as this machine's own program finds; rounding differs with the width of vectors. Under qemu a picture
# takes minutes.
native=${SMR_GPU_PROGRAM:-target/release/smr-gpu}
for device in cpu "cpu --precision int8" gpu; do
    # shellcheck disable=SC2206
    detect=(
        detect --json --quiet --weights small --mm-per-pixel 0.04 --timeout 1800 --device $device samples/mixed.png
    )
    { "$native" "${detect[@]}"; smr_gpu "${detect[@]}"; } | python3 -c '
import json, sys
native, foreign = ([(d["class"], d["score"], *d["box"]) for d in json.loads(line)["detections"]] for line in sys.stdin)
assert native and [d[0] for d in native] == [d[0] for d in foreign], (native, foreign)
apart = [max(abs(a - b) for one, other in zip(native, foreign) for a, b in zip(one[part], other[part]))
         for part in (slice(1, 2), slice(2, 6))]
print(f"{sys.argv[1]}: {len(native)} snaps, scores {apart[0]:.1e} and corners {apart[1]:.1e} pixels apart")
assert apart[0] < 1e-3 and apart[1] < 0.05
' "$device"
done
