#!/usr/bin/env bash
# `cargo build` and `cargo test` must agree on the features of every crate they share;
# otherwise whoever runs one after the other builds everything above that crate twice.
set -euo pipefail
cd "$(dirname "$0")/.."
tree() { cargo tree --locked --prefix none --no-dedupe -f '{p} [{f}]' "$@" | sed 's/ (\*)$//' | sort -u; }
only_build="$(comm -23 <(tree -e no-dev) <(tree))"
if [[ -n "$only_build" ]]; then
    echo "these have more features under cargo test than under cargo build;" >&2
    echo "name them in [dependencies] with the missing ones:" >&2
    echo "$only_build" >&2
    exit 1
fi
