#!/usr/bin/env bash
# Tests report.html in a real browser: makes reports of synthetic scans and drives Chromium over
# them. Takes the binary to test (target/release/scanweave). Needs Node.js, npm and Chromium
# (CHROMIUM says where it is; /usr/bin/chromium otherwise).
set -euo pipefail
cd "$(dirname "$0")/.."
scanweave="$(realpath "${1:-${CARGO_TARGET_DIR:-target}/release/scanweave}")"
REPORTS="$(mktemp -d)"
export REPORTS
trap 'rm -rf "$REPORTS"' EXIT

"$scanweave" synth -q --scans 5 --unrelated 1 --rooms 1 --noise 0.3 -o "$REPORTS/scans"
"$scanweave" register -q "$REPORTS/scans" -o "$REPORTS/plain"

# The same result where its scans are no more.
cp -r "$REPORTS/plain" "$REPORTS/gone"
mv "$REPORTS/scans" "$REPORTS/scans-moved"
"$scanweave" report -q "$REPORTS/gone" 2>/dev/null
mv "$REPORTS/scans-moved" "$REPORTS/scans"

# Names as an attacker would choose them. A name cannot hold a slash: a folder lends it one.
"$scanweave" synth -q --scans 4 --rooms 1 --noise 0.3 -o "$REPORTS/more"
odd="$REPORTS/odd"
mkdir -p "$odd/a<" "$odd/b<" "$odd/c"
names=(
    "a</script><img src=x onerror=window.hacked=1>"
    "b</script><img src=x onerror=window.hacked=1>"
    $'c/"\'&quot; --><svg onload=window.hacked=2>\nline'
    $'c/bytes \xff\xfe <!--data--><!--headline-->'
)
for i in 0 1 2 3; do
    cp "$REPORTS/more/PointCloud/cloud_bin_$i.ply" "$odd/${names[$i]}.ply"
done
"$scanweave" register -q "$odd/a<" "$odd/b<" "$odd/c" -o "$REPORTS/hostile"
# What cannot be shown (a line break, bytes that are no text) is replaced by U+FFFD.
export HOSTILE_NAMES='["a</script><img src=x onerror=window.hacked=1>", "b</script><img src=x onerror=window.hacked=1>",
    "\"'"'"'&quot; --><svg onload=window.hacked=2>\ufffdline", "bytes \ufffd\ufffd <!--data--><!--headline-->"]'

# Two buildings: two models that have nothing to do with each other.
"$scanweave" synth -q --seed 1 --scans 3 --rooms 1 --noise 0.3 -o "$REPORTS/else"
"$scanweave" register -q "$REPORTS/more" "$REPORTS/else" -o "$REPORTS/two"

cd tests/browser
npm ci --silent --no-audit --no-fund --ignore-scripts
node --test --test-reporter=spec report.test.mjs
