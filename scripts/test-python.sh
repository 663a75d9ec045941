#!/usr/bin/env bash
# The Python package from a clean environment: builds the wheel, installs it into a fresh virtual environment, and
# there runs the tests (with the code of the pages, and on a local Ray cluster where Ray can be installed), mypy --strict
# over package, stubs, tests and examples, and the build of the pages. SCANWEAVE_BINARY may name a binary built by cargo, to compare bytes with.
# usage: scripts/test-python.sh [WHEEL]
set -euo pipefail
cd "$(dirname "$0")/.."
place="$(mktemp -d)"
trap 'rm -rf "$place"' EXIT
step() { echo "-- $* ($SECONDS s)"; }

step "build"
wheel="${1:-}"
if [[ -z "$wheel" ]]; then
    scripts/build-wheel.sh "$place/wheels"
    wheel="$(echo "$place"/wheels/scanweave-*.whl)"
fi

step "a fresh environment"
python3 -m venv "$place/venv"
bin="$place/venv/bin"
"$bin/pip" install -q "$wheel"
# Two commands: this is all that a user needs.
(cd "$place" && "$bin/python" -c "import scanweave; print(scanweave.__version__)" && "$bin/scanweave" --version)
"$bin/pip" install -q "$wheel[ray]" || echo "Ray cannot be installed here: its tests are skipped"
"$bin/pip" install -q pytest mypy tqdm trimesh mkdocs-material 'mkdocstrings[python]'

# Away from the sources, so that what is installed is what is tested.
cp -r python "$place/python"
cd "$place/python"
rm -rf scanweave/__pycache__
mv scanweave "$place/sources"

step "types"
"$bin/mypy" --strict -p scanweave
"$bin/mypy" --strict tests examples docs/make_data.py
"$bin/python" -m mypy.stubtest scanweave._scanweave

step "tests"
"$bin/python" -m pytest -q -p no:cacheprovider tests

step "pages"
mv "$place/sources" scanweave
"$bin/mkdocs" build -q -f mkdocs.yml -d "$place/site"
step "done"
