#!/usr/bin/env bash
# Builds the documentation as a web site, target/book/index.html; mdBook too, where it is not built yet.
# Fails where mdBook warns. Needs Rust.
set -euo pipefail
cd "$(dirname "$0")/.."

target=${CARGO_TARGET_DIR:-target}
version=0.5.4
mdbook=$target/tools/bin/mdbook
if [ "$("$mdbook" --version 2>/dev/null)" != "mdbook v$version" ]; then
    cargo install --quiet --locked --no-default-features --version "$version" \
        --root "$target/tools" mdbook
fi
said=$("$mdbook" build --dest-dir "$PWD/target/book" 2>&1) || {
    echo "$said"
    exit 1
}
echo "$said"
! grep -E "WARN|ERROR" <<<"$said"
