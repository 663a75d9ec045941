#!/usr/bin/env bash
# Reads what `register --trajectory --pose-graph` and `export` write with programs that are not ours: numpy,
# Open3D, plyfile, laspy, pye57, pypcd4. Takes the binary to test (target/release/scanweave) and a Python environment that has
# them; without one, a throw-away environment is made and the packages that can be had are installed.
# What cannot be had is skipped with a line that says so.
set -euo pipefail
cd "$(dirname "$0")/.."
scanweave="$(realpath "${1:-${CARGO_TARGET_DIR:-target}/release/scanweave}")"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT

if [[ -n "${2:-}" ]]; then
    python="$2/bin/python"
else
    python3 -m venv "$work/environment"
    python="$work/environment/bin/python"
    for package in numpy plyfile pye57 "laspy[lazrs]" pypcd4 open3d; do
        "$python" -m pip install -q --disable-pip-version-check "$package" 2>"$work/pip.log" ||
            echo "skipped: pip cannot install $package: $(tail -n 1 "$work/pip.log")"
    done
fi

# Two buildings, so that there are two components, and a scan of neither.
"$scanweave" synth -q --seed 0 --scans 5 --unrelated 1 --rooms 1 --noise 0.3 -o "$work/one"
"$scanweave" synth -q --seed 1 --scans 4 --rooms 1 --noise 0.3 -o "$work/two"
"$scanweave" register -q "$work/one" "$work/two" -o "$work/result" \
    --trajectory tum,kitti,csv,colmap --pose-graph g2o,open3d
"$scanweave" export -q "$work/result" -o "$work/exported" \
    --trajectory tum,kitti,csv,colmap --pose-graph g2o,open3d
# A method whose edges are the registered pairs.
"$scanweave" register -q "$work/one" -o "$work/global" --method eigse3 \
    --trajectory tum,kitti,csv,colmap --pose-graph g2o,open3d
"$python" scripts/check_exports.py "$work/result" "$work/exported" --poses "$work/result/poses.json"
"$python" scripts/check_exports.py "$work/global" --poses "$work/global/poses.json"

# Whole scans, near zero and at coordinates of a map.
"$python" scripts/big_scans.py "$work/near" --scans 2 --points 150000
"$python" scripts/big_scans.py "$work/far" --scans 2 --points 150000 --origin 431250.125 5812345.25 101.5
for scans in near far; do
    "$scanweave" register -q "$work/$scans" -o "$work/$scans-result"
    for format in ply pcd las laz e57; do
        folder="$work/$scans-$format"
        "$scanweave" export -q "$work/$scans-result" --export-scans "$folder" --format "$format"
        "$python" scripts/check_exported_scans.py "$work/$scans-result" "$format" "$folder"
    done
done
# The check is worth something only if a wrong byte makes it fail: one in the middle of a file is.
for wrong in near-ply/big_0.ply near-pcd/big_0.pcd near-las/big_0.las near-laz/big_0.laz near-e57/scans.e57; do
    "$python" - "$work/$wrong" <<'END'
import sys

data = bytearray(open(sys.argv[1], "rb").read())
data[len(data) // 2] ^= 0x55
open(sys.argv[1], "wb").write(data)
END
    format="${wrong##*.}"
    said="$("$python" scripts/check_exported_scans.py "$work/near-result" "$format" "$work/near-$format" 2>&1)" &&
        [[ "$said" != skipped* ]] && { echo "a wrong byte in $wrong was not found" >&2; exit 1; }
    echo "$format with a wrong byte: $(tail -n 1 <<<"$said")"
done
