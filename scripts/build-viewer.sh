#!/usr/bin/env bash
# Builds src/report/html/page.html from scripts/viewer/. With --check only says whether the
# committed page is what the sources give. Needs Node.js and npm.
set -euo pipefail
cd "$(dirname "$0")/viewer"
npm ci --silent --no-audit --no-fund --ignore-scripts
if [[ "${1:-}" == "--check" ]]; then
    built="$(mktemp)"
    trap 'rm -f "$built"' EXIT
    node build.mjs "$built"
    cmp "$built" ../../src/report/html/page.html || {
        echo "src/report/html/page.html is not what scripts/viewer/ gives: run scripts/build-viewer.sh" >&2
        exit 1
    }
else
    node build.mjs
fi
