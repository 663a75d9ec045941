#!/usr/bin/env bash
# Tests the pages of `register`, `evaluate` and `benchmark` in a real browser: makes them from synthetic
# scans and opens them in Chromium. Takes the binary to test (target/release/scanweave). Needs Node.js, npm and Chromium
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

# The page of an evaluation: a scene of a hostile name, with a scan that was moved away by 5 m.
scene="$REPORTS/set/<img src=x onerror=window.hacked=3>"
mkdir -p "$scene"
cp -r "$REPORTS/more/." "$scene"
"$scanweave" register -q "$scene/PointCloud" -o "$REPORTS/results/${scene##*/}"
node -e '
    const fs = require("node:fs");
    const file = process.argv[1];
    const poses = JSON.parse(fs.readFileSync(file));
    const leaf = poses.scans.findIndex((s, i) => s.parent !== null && poses.scans.every((t) => t.parent !== i));
    poses.scans[leaf].world_from_scan[0][3] += 5;
    fs.writeFileSync(file, JSON.stringify(poses));' "$REPORTS/results/${scene##*/}/poses.json"
"$scanweave" evaluate -q "$REPORTS/results" --dataset "$REPORTS/set" --report "$REPORTS/evaluation.html"

# The page of a suite with hostile names, half of it computed.
cat > "$REPORTS/suite.toml" <<'SUITE'
name = "</title><script>window.hacked=4</script>"
keypoints = [150, 300]
computed_keypoints = 300
[[datasets]]
name = "made <b>"
synthetic = { scans = 4, rooms = 1, width = 120, height = 90, frames_per_scan = 3, voxel_m = 0.03 }
synthetic_seeds = [3, 4]
benchmarks = [{ name = "hi", protocol = "3dmatch" }]
[[methods]]
name = "<svg onload=window.hacked=5>"
set = ["registration.estimator.hypotheses=200"]
[[quoted]]
source = "Somebody 1999 <!--body-->"
method = "theirs"
benchmark = "hi"
scenes = 8
keypoints = [150, 300]
recall_percent = [12.5, 99.5]
SUITE
"$scanweave" benchmark -q --suite "$REPORTS/suite.toml" -o "$REPORTS/suite" --shard 0/2

cd tests/browser
npm ci --silent --no-audit --no-fund --ignore-scripts
node --test --test-reporter=spec report.test.mjs sheet.test.mjs
