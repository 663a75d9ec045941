#!/usr/bin/env bash
# Time and peak memory of registering two scans of many points and of exporting them in every format.
# Takes the binary (target/release/scanweave), the points of a scan (20000000) and a Python with numpy
# (python3). Needs GNU time, and 4 GB of disk for 20 million points.
set -euo pipefail
cd "$(dirname "$0")/.."
scanweave="$(realpath "${1:-${CARGO_TARGET_DIR:-target}/release/scanweave}")"
points="${2:-20000000}"
python="${3:-python3}"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT

"$python" scripts/big_scans.py "$work/scans" --scans 2 --points "$points" >/dev/null
measured() {
    local name="$1"
    shift
    /usr/bin/time -f "%e %M" -o "$work/time" "$@" >/dev/null
    awk -v name="$name" '{printf "%-14s %8.1f s %8.0f MB\n", name, $1, $2 / 1024}' "$work/time"
}
echo "2 scans of $points points, $(nproc) cores"
measured register "$scanweave" register -q "$work/scans" -o "$work/result"
"$scanweave" inspect "$work/result/poses.json" | grep -i placed | head -n 1 || true
for format in ply pcd las laz e57; do
    measured "export $format" "$scanweave" export -q "$work/result" --export-scans "$work/out" --format "$format"
    rm -rf "$work/out"
done
