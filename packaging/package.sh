#!/usr/bin/env bash
# Packs the program with the large network, man pages and completions as a tarball, as they lie below /usr or
# /usr/local: packaging/package.sh [TARGET], a Rust target of Linux, by default this machine's. It lies in
# target/packages, and runs where glibc is as new as the program's symbols. For another kind of processor the system
# must run its programs (qemu-user's binfmt), or $CARGO_TARGET_…_RUNNER says what does, as cargo takes it.
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

cross=()
[ "$target" = "$host" ] || cross=(--target "$target")
cargo build --release --locked "${cross[@]}" --bin smr-gpu
built=${CARGO_TARGET_DIR:-target}/${cross[1]:-.}/release/smr-gpu
variable=CARGO_TARGET_$(tr 'a-z-' 'A-Z_' <<< "$target")_RUNNER
read -ra runner <<< "${!variable:-}"

# As it lies below /usr.
name=smr-gpu-$version-$target
tree=$out/$name
rm -rf "$tree"
mkdir -p "$tree/bin"
"${target%%-*}-linux-gnu-strip" -o "$tree/bin/smr-gpu" "$built"
share=$tree/share
"${runner[@]}" "$built" shell --man "$share/man/man1"
completions() {
    mkdir -p "$(dirname "$share/$2")"
    "${runner[@]}" "$built" shell --completions "$1" > "$share/$2"
}
completions bash bash-completion/completions/smr-gpu
completions zsh zsh/vendor-completions/_smr-gpu
completions fish fish/vendor_completions.d/smr-gpu.fish
# The small network is in the program.
install -D -m 644 weights/smrnet.safetensors "$share/smr-gpu/weights/smrnet.safetensors"
install -D -m 644 -t "$share/doc/smr-gpu" README.md LICENSE-MIT LICENSE-APACHE
install -D -m 644 assets/font/LICENSE "$share/doc/smr-gpu/LICENSE-font"

tar --create --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" \
    --directory "$out" "$name" | gzip -n > "$tree.tar.gz"

ls -l "$out"
