#!/usr/bin/env bash
# Registers many scans of forty random points, which cannot be placed: the time and memory of describing, comparing
# and declining them, and how soon an interrupted run ends.
#
# Usage: tiny-scans.sh SCANWEAVE [SCANS [SECONDS...]]
#   SCANS      default 10000
#   SECONDS    when runs are interrupted (default 3 10 20 30 40)        needs Linux with GNU time
set -euo pipefail
scanweave="$(realpath "$1")"
scans="${2:-10000}"
moments=("${@:3}")
[[ ${#moments[@]} -gt 0 ]] || moments=(3 10 20 30 40)
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"
mkdir scans
awk -v scans="$scans" 'BEGIN {
    srand(1)
    for (scan = 0; scan < scans; scan++) {
        file = sprintf("scans/%05d.xyz", scan)
        for (point = 0; point < 40; point++) print 10 * rand(), 10 * rand(), 3 * rand() > file
        close(file)
    }
}'
code=0
/usr/bin/time -f '%e s, %M kB at most' "$scanweave" register -q scans -o out --set descriptor.kind=fpfh 2>said || code=$?
[[ $code -eq 6 ]] || { cat said >&2; echo "exit code $code, 6 expected: nothing is placed" >&2; exit 1; }
echo "$scans scans described, compared and declined: $(tail -n 1 said)"
for moment in "${moments[@]}"; do
    rm -rf out
    # A shell without job control starts what runs beside it with SIGINT ignored.
    env --default-signal=INT "$scanweave" register -q scans -o out --set descriptor.kind=fpfh 2>said &
    run=$!
    sleep "$moment"
    kill -INT "$run" 2>/dev/null || { wait "$run" || true; echo "interrupted after $moment s: had ended"; continue; }
    since="$(date +%s.%N)"
    code=0
    wait "$run" || code=$?
    echo "interrupted after $moment s: ended $(awk -v a="$since" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f", b - a }') s later, exit code $code: $(tail -n 1 said)"
done
