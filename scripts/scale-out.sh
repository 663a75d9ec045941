#!/usr/bin/env bash
# One process against two shards of one thread each, and against Ray with two workers where the Python package and
# Ray are there: compares the bytes of the results and prints times as a table. On a synthetic building.
#
# Usage: [PYTHON=PYTHON] scale-out.sh SCANWEAVE OUT [SCANS]      PYTHON: an interpreter with scanweave[ray]
set -euo pipefail
scanweave=$1 out=$2 scans=${3:-24}
[[ ! -e "$out" ]] || { echo "$out is there already: name a new folder" >&2; exit 1; }
mkdir -p "$out"
set="$out/set/PointCloud"
"$scanweave" synth -q -o "$out/set" --scans "$scans" --rooms $((scans / 12 + 1)) --seed 7

now() { date +%s.%N; }
since() { awk -v a="$1" -v b="$(now)" 'BEGIN { printf "%.1f", b - a }'; }
# Seconds of processors that all processes have taken that have ended: not those of Ray's workers.
used() { times >"$out/times"; awk 'NR == 2 { gsub("s", ""); split($1, u, "m"); split($2, s, "m"); printf "%.1f", 60 * (u[1] + s[1]) + u[2] + s[2] }' "$out/times"; }
more() { awk -v a="$1" -v b="$2" 'BEGIN { printf "%.1f", b - a }'; }
row() { echo "| $1 | $2 | $3 | $4 | $5 | $6 |"; }
same() {
    local file
    for file in poses.json merged.ply trajectory.log overlap.csv config.toml registration.html; do
        cmp "$out/one/$file" "$1/$file" || { echo "$1: $file differs" >&2; exit 1; }
    done
}
# Both shards of a stage at the same time.
shards() {
    local one two
    "$scanweave" "$@" -q --threads 1 --shard 0/2 & one=$!
    "$scanweave" "$@" -q --threads 1 --shard 1/2 & two=$!
    wait "$one" && wait "$two"
}

echo "$scans scans, $(nproc) cores"
echo "| | describe, s | pairs, s | join, s | in all, s | processors, s |"
echo "|---|--:|--:|--:|--:|--:|"
for threads in 1 2; do
    result="$out/one"
    [[ $threads == 1 ]] || result="$out/two-threads"
    start=$(now)
    used >"$out/before"
    "$scanweave" register -q "$set" -o "$result" --threads "$threads"
    used >"$out/after"
    row "one process, threads: $threads" "" "" "" "$(since "$start")" "$(more "$(<"$out/before")" "$(<"$out/after")")"
    same "$result"
done

start=$(now)
used >"$out/before"
shards describe "$set" -o "$out/features"
describe=$(since "$start") at=$(now)
shards pairs "$set" --described "$out/features" -o "$out/pairs"
pairs=$(since "$at") at=$(now)
"$scanweave" register -q "$set" -o "$out/joined" --described "$out/features" --pairs "$out/pairs" --threads 1
used >"$out/after"
row "two shards, a thread each" "$describe" "$pairs" "$(since "$at")" "$(since "$start")" "$(more "$(<"$out/before")" "$(<"$out/after")")"
same "$out/joined"

if [[ -n "${PYTHON:-}" ]] && "$PYTHON" -c "import ray, scanweave" 2>/dev/null; then
    "$PYTHON" - "$set" "$out/ray" <<'PY'
import sys, time
import ray, scanweave.ray

scans, output = sys.argv[1:]
ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
# Workers that have started, as on a cluster that runs already.
warm = ray.remote(lambda: __import__("scanweave") and time.sleep(1))
ray.get([warm.remote() for _ in range(2)])
ends, start = {}, time.perf_counter()
scanweave.ray.register(
    scans,
    output=output,
    shards=2,
    progress=lambda stage, done, total: done == total and ends.setdefault(stage, time.perf_counter()),
)
end = time.perf_counter()
described, paired = ends["shards of features"], ends["shards of pairs"]
times = (described - start, paired - described, end - paired, end - start)
print("| Ray, two workers |", " | ".join(f"{seconds:.1f}" for seconds in times), "| |")
PY
    same "$out/ray"
else
    echo "no Ray: set PYTHON to an interpreter with scanweave[ray]"
fi
echo "the same bytes: poses.json, merged.ply, trajectory.log, overlap.csv, config.toml, registration.html"
