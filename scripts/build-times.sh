#!/usr/bin/env bash
# Clean release builds: packages that each is made from, seconds, and seconds of all processors together, which other
# work on the machine hardly changes. Every build starts from an empty target folder; crates are fetched before.
#
# Usage: build-times.sh [core|command|training]...      the core, the command without training and with it; default all
set -euo pipefail
cd "$(dirname "$0")/.."
cargo fetch --locked --quiet
target="$(mktemp -d)"
trap 'rm -rf "$target"' EXIT
echo "$(nproc) cores, $(rustc --version)"
printf '| build | packages | seconds | processor seconds |\n|---|--:|--:|--:|\n'
measure() {
    local name="$1" packages taken
    shift
    packages="$(cargo tree --locked --offline "$@" -e normal --prefix none --no-dedupe | awk '{print $1}' | sort -u | wc -l)"
    rm -rf "$target"
    TIMEFORMAT="%0R %0U %0S"
    taken="$({ time CARGO_TARGET_DIR="$target" cargo build --release --locked --offline --quiet "$@" >&2 2>/dev/null; } 2>&1)"
    awk -v name="$name" -v packages="$packages" '{printf "| %s | %s | %s | %s |\n", name, packages, $1, $2 + $3}' <<<"$taken"
}
[[ $# -gt 0 ]] || set -- core command training
for build in "$@"; do
    case "$build" in
    core) measure "\`scanweave-core\`" -p scanweave-core ;;
    command) measure "\`scanweave\` without training" -p scanweave --no-default-features ;;
    training) measure "\`scanweave\`" -p scanweave ;;
    *) echo "build-times.sh: found $build, expected core, command or training" >&2; exit 2 ;;
    esac
done
