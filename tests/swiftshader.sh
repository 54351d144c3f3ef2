#!/usr/bin/env bash
# Runs the tests on SwiftShader, a second software adapter: subgroups of 4, no f16.
# Usage: tests/swiftshader.sh [vk_swiftshader_icd.json]
# Without an argument it takes the library of Debian's package chromium-common, which it unpacks under
# target/ and does not install.
set -euo pipefail
cd "$(dirname "$0")/.."

icd=${1:-}
if [ -z "$icd" ]; then
    folder=$PWD/target/swiftshader
    library=$folder/usr/lib/chromium/libvk_swiftshader.so
    if [ ! -e "$library" ]; then
        mkdir -p "$folder"
        (cd "$folder" && apt-get download chromium-common && dpkg -x chromium-common_*.deb .)
        if [ ! -e "$library" ]; then
            echo "$library: expected it in chromium-common, which does not hold it"
            exit 1
        fi
    fi
    # The package's own file lacks the version without which older loaders pass it over.
    icd=$folder/icd.json
    printf '{"file_format_version": "1.0.0", "ICD": {"library_path": "%s", "api_version": "1.3.0"}}\n' \
        "$library" >"$icd"
fi

export VK_ICD_FILENAMES=$icd VK_DRIVER_FILES=$icd
cargo build --locked --release
devices=$(target/release/smr-gpu devices)
echo "$devices"
if ! grep -q SwiftShader <<<"$devices"; then
    echo "$icd: expected SwiftShader, got another adapter"
    exit 1
fi
cargo test --locked --release
target/release/smr-gpu check --device gpu
