#!/usr/bin/env bash
# Builds the pages src/report/html/page.html and src/report/sheet/page.html from scripts/viewer/.
# With --check only says whether the committed ones are what the sources give. Needs Node.js and npm.
set -euo pipefail
cd "$(dirname "$0")/viewer"
npm ci --silent --no-audit --no-fund --ignore-scripts
if [[ "${1:-}" == "--check" ]]; then
    built="$(mktemp -d)"
    trap 'rm -rf "$built"' EXIT
    mkdir "$built/html" "$built/sheet"
    node build.mjs "$built"
    for page in html sheet; do
        cmp "$built/$page/page.html" "../../src/report/$page/page.html" || {
            echo "src/report/$page/page.html is not what scripts/viewer/ gives: run scripts/build-viewer.sh" >&2
            exit 1
        }
    done
else
    node build.mjs
fi
