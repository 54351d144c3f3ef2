#!/usr/bin/env bash
# Puts Debian unstable's rustc with its wasm32 library into FOLDER, for machines whose own rustc lacks the
# target wasm32-unknown-unknown and that have no rustup to add it. Usage: bindings/web/toolchain.sh FOLDER [PACKAGE…]
# The packages come, too, such as libstd-rust-dev:arm64 for the target aarch64-unknown-linux-gnu.
# Needs apt and 1.5 GB, but neither root nor a chroot: FOLDER/bin/rustc and FOLDER/bin/wasm-ld run beside the
# machine's own programs.
set -euo pipefail
[ $# -gt 0 ] || { echo "expected a folder, got nothing"; exit 2; }
mkdir -p "$1"/{bin,root,apt/lists/partial,apt/archives/partial}
cd "$1"
shift
folder=$PWD

# The machine's own mirror, settings and keys.
mirror=$(apt-get indextargets --format '$(SITE)' 'Created-By: Packages' | grep -m1 '/debian/\?$')
keys=/usr/share/keyrings/debian-archive-keyring.gpg
echo "deb [signed-by=$keys] $mirror sid main" >apt/sources.list
# An apt of its own that takes nothing for installed.
touch apt/status
apt=(
    apt-get --quiet --yes --no-install-recommends
    -o "Dir::State=$folder/apt" -o "Dir::State::status=$folder/apt/status" -o "Dir::Cache=$folder/apt"
    -o "Dir::Etc::SourceList=$folder/apt/sources.list" -o Dir::Etc::SourceParts=/dev/null
    -o Acquire::Check-Valid-Until=false -o APT::Sandbox::User= -o Debug::NoLocking=true
    -o APT::Architectures::=amd64 -o APT::Architectures::=arm64
)
"${apt[@]}" update
"${apt[@]}" --download-only install rustc libstd-rust-dev libstd-rust-dev-wasm32 lld "$@"
for package in apt/archives/*.deb; do
    dpkg-deb --extract "$package" root
done
rm -r apt

# A program with the libraries that it came with. Usage: wrap PROGRAM [OPTIONS]
wrap() {
    cat >"bin/$1" <<SCRIPT
#!/usr/bin/env bash
root=\$(dirname "\$(readlink -f "\$0")")/../root/usr
libraries=\$root/lib/\$(uname -m)-linux-gnu
exec "\$libraries"/ld-linux-*.so.* --library-path "\$libraries" --argv0 "\$0" "\$root/bin/$1" ${2:-} "\$@"
SCRIPT
    chmod +x "bin/$1"
}
wrap rustc '--sysroot "$root"'
wrap wasm-ld
bin/rustc --version
