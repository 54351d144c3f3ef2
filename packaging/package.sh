#!/usr/bin/env bash
# Packs the program with the large network, man pages and completions, as a tarball that is unpacked below /usr or
# /usr/local and as a Debian package: packaging/package.sh [TARGET], a Rust target of Linux, by default this machine's.
# They lie in target/packages, and run where glibc is as new as the program's symbols. Needs dpkg-deb and binutils.
# For another kind of processor the system must run its programs (qemu-user's binfmt), or $CARGO_TARGET_…_RUNNER says
# what does, as cargo takes it.
set -euo pipefail
cd "$(dirname "$0")/.."
host=$(rustc -vV | sed -n 's/^host: //p')
target=${1:-$host}
version=$(cargo pkgid | sed 's/.*[#@]//')
out=target/packages
mkdir -p "$out"
# What two runs pack of a commit is equal to the byte.
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)
SMR_GPU_COMMIT=$(git rev-parse --short=12 HEAD) # for `--version`
export SOURCE_DATE_EPOCH SMR_GPU_COMMIT
umask 022

cross=()
[ "$target" = "$host" ] || cross=(--target "$target")
cargo build --release --locked "${cross[@]}" --bin smr-gpu
built=${CARGO_TARGET_DIR:-target}/${cross[1]:-.}/release/smr-gpu
variable=CARGO_TARGET_$(tr 'a-z-' 'A-Z_' <<<"$target")_RUNNER
read -ra runner <<<"${!variable:-}"
binutils=${target%%-*}-linux-gnu

# As it lies below /usr.
name=smr-gpu-$version-$target
tree=$out/$name
rm -rf "$tree"
mkdir -p "$tree/bin"
"$binutils-strip" -o "$tree/bin/smr-gpu" "$built"
share=$tree/share
"${runner[@]}" "$built" shell --man "$share/man/man1"
completions() {
    mkdir -p "$(dirname "$share/$2")"
    "${runner[@]}" "$built" shell --completions "$1" >"$share/$2"
}
completions bash bash-completion/completions/smr-gpu
completions zsh zsh/vendor-completions/_smr-gpu
completions fish fish/vendor_completions.d/smr-gpu.fish
# The small network is in the program.
install -D -m 644 weights/smrnet.safetensors "$share/smr-gpu/weights/smrnet.safetensors"
install -D -m 644 -t "$share/doc/smr-gpu" README.md LICENSE-MIT LICENSE-APACHE
install -D -m 644 assets/font/LICENSE "$share/doc/smr-gpu/LICENSE-font"

tar --create --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" \
    --directory "$out" "$name" | gzip -n >"$tree.tar.gz"

# The same as Debian wants it.
declare -A architectures=([x86_64]=amd64 [aarch64]=arm64)
architecture=${architectures[${target%%-*}]}
deb=$out/deb
rm -rf "$deb"
mkdir -p "$deb/DEBIAN"
cp -r "$tree" "$deb/usr"
find "$deb/usr/share/man" -type f -exec gzip -9n {} +
doc=$deb/usr/share/doc/smr-gpu
{
    echo "smr-gpu is licensed under Apache-2.0, which is /usr/share/common-licenses/Apache-2.0, or under MIT,"
    echo "as you choose; the font DejaVu Sans in it under the last text."
    cat LICENSE-MIT assets/font/LICENSE
} >"$doc/copyright"
rm "$doc"/LICENSE-*
cp CHANGELOG.md "$doc"
maintainer="The developers of smr-gpu <smr-gpu@example.org>"
gzip -9n >"$doc/changelog.gz" <<CHANGELOG
smr-gpu ($version) unstable; urgency=medium

  * CHANGELOG.md has the changes.

 -- $maintainer  $(LC_ALL=C date --utc --rfc-email --date "@$SOURCE_DATE_EPOCH")
CHANGELOG
glibc=$("$binutils-objdump" -T "$built" | grep -o 'GLIBC_[0-9.]*' | sort -uV | tail -1)
cat >"$deb/DEBIAN/control" <<CONTROL
Package: smr-gpu
Version: $version
Architecture: $architecture
Maintainer: $maintainer
Installed-Size: $(du -sk "$deb/usr" | cut -f1)
Depends: libc6 (>= ${glibc#GLIBC_}), libgcc-s1
Recommends: libvulkan1, mesa-vulkan-drivers | vulkan-icd
Suggests: ffmpeg
Section: science
Priority: optional
Description: finds snap joints in pictures of a tactile sensor
 Class, box, position in millimetres and direction of snap joints, found in
 pictures of a GelSight-like sensor on any GPU with Vulkan or on the CPU.
CONTROL
# What is large in it does not compress.
dpkg-deb --build --root-owner-group -Zxz -z1 "$deb" "$out/smr-gpu_${version}_$architecture.deb"
rm -r "$deb"

ls -l "$out"
