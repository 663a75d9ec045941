#!/usr/bin/env bash
# Seconds of clean release builds, and packages that each is built from: the core, the command without training, and the
# command with it. Every build starts from an empty target folder; crates must have been fetched before.
#
# Usage: build-times.sh
set -euo pipefail
cd "$(dirname "$0")/.."
cargo fetch --locked --quiet
target="$(mktemp -d)"
trap 'rm -rf "$target"' EXIT
echo "$(nproc) cores, $(rustc --version)"
printf '| build | packages | seconds |\n|---|--:|--:|\n'
measure() {
    local name="$1" packages begin
    shift
    packages="$(cargo tree --locked --offline "$@" -e normal --prefix none --no-dedupe | awk '{print $1}' | sort -u | wc -l)"
    rm -rf "$target"
    begin="$(date +%s)"
    CARGO_TARGET_DIR="$target" cargo build --release --locked --offline --quiet "$@"
    printf '| %s | %s | %s |\n' "$name" "$packages" "$(($(date +%s) - begin))"
}
measure "\`scanweave-core\`" -p scanweave-core
measure "\`scanweave\` without training" -p scanweave --no-default-features
measure "\`scanweave\`" -p scanweave
