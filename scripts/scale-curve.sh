#!/usr/bin/env bash
# Time and memory of a registration by the number of scans: synthetic buildings with fifteen scans a
# room, features given (FPFH, 2500 keypoints). Prints a table; existing files are reused.
#
# Usage: scale-curve.sh SCANWEAVE OUT [SCANS...]      needs jq
set -euo pipefail
scanweave=$1 out=$2
shift 2
[[ $# -gt 0 ]] || set -- 60 125 250 500 1000
mkdir -p "$out"
echo "| scans | placed | largest component | right of the true pairs, % | registration, s | in all, s | memory at most, GB |"
echo "|--:|--:|--:|--:|--:|--:|--:|"
for scans in "$@"; do
    set="$out/$scans"
    [[ -d "$set/building" ]] || "$scanweave" synth -q -o "$set/building" --scans "$scans" --rooms $((scans / 15)) --seed 7
    [[ -d "$set/features" ]] || "$scanweave" describe -q "$set/building/PointCloud" -o "$set/features" \
        --set descriptor.kind=fpfh --set descriptor.keypoints.count=2500
    [[ -f "$set/result/poses.json" ]] || "$scanweave" register -q "$set/building/PointCloud" -o "$set/result" --force \
        --features "$set/features" --set descriptor.kind=precomputed
    "$scanweave" evaluate "$set/result" --truth "$set/building" --benchmark "$set/building" --json >"$set/errors.json"
    jq -r --slurpfile errors "$set/errors.json" --slurpfile poses "$set/result/poses.json" '
        def fixed: . * 10 | round / 10;
        ([.timings[] | select(.stage == "registration").seconds] | add) as $registration
        | ([$poses[0].scans[] | .component // empty] | group_by(.) | map(length) | max) as $largest
        | ([$errors[0].benchmarks[]][0]) as $recall
        | "| \(.placed + .declined) | \(.placed) | \($largest) | \($recall.succeeded / $recall.counted * 100 | fixed) | \($registration | fixed) | \(.total_seconds | fixed) | \(.peak_memory_bytes / 1e9 * 100 | round / 100) |"
    ' "$set/result/report.json"
done
