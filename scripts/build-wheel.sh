#!/usr/bin/env bash
# Builds the wheel of the Python package into a folder (target/wheels) and prints its size and the time that it
# took. Takes maturin from the PATH, else installs it into a virtual environment below target/.
# usage: scripts/build-wheel.sh [FOLDER] [options of maturin build …]
set -euo pipefail
cd "$(dirname "$0")/.."
out="${1:-target/wheels}"
shift || true
if ! command -v maturin >/dev/null; then
    [[ -x target/maturin/bin/maturin ]] || { python3 -m venv target/maturin; target/maturin/bin/pip install -q 'maturin>=1.9.4,<2'; }
    PATH="$PWD/target/maturin/bin:$PATH"
fi
mkdir -p "$out"
rm -f "$out"/scanweave-*.whl
TIMEFORMAT="%R s, %U s of processors"
time maturin build --release --locked --manifest-path python/Cargo.toml --out "$out" "$@"
for wheel in "$out"/scanweave-*.whl; do
    echo "$(basename "$wheel"): $(($(stat -c %s "$wheel" 2>/dev/null || stat -f %z "$wheel") / 1000)) kB"
done
