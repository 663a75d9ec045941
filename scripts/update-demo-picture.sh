#!/usr/bin/env bash
# Draws docs/demo.svg again: the result of `scanweave demo` seen from above.
set -euo pipefail
cd "$(dirname "$0")/.."
result="$(mktemp -d)"
trap 'rm -rf "$result"' EXIT
cargo run --release -- demo -q --output "$result"
cp "$result/top_view.svg" docs/demo.svg
