#!/usr/bin/env bash
# Draws the pictures of the README again: docs/demo.svg, the result of `scanweave demo` seen from
# above, and docs/report.png, the report of a demo with unrelated scans. The second needs
# Node.js and Chromium.
set -euo pipefail
cd "$(dirname "$0")/.."
result="$(mktemp -d)"
trap 'rm -rf "$result"' EXIT
cargo run --release -- demo -q --output "$result"
cp "$result/top_view.svg" docs/demo.svg
cargo run --release -- demo -q --force --scans 12 --unrelated 2 --output "$result"
(cd tests/browser && npm ci --silent --no-audit --no-fund --ignore-scripts)
node scripts/report-picture.mjs "$result/report.html" docs/report.png
