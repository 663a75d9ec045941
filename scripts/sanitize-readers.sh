#!/usr/bin/env bash
# The readers that stand on crates with `unsafe` code (LAZ, E57, PNG, JPEG, deflate, safetensors, NumPy arrays)
# under the address sanitizer: over the whole corpus that there is, and over so many executions more of each.
#
#   scripts/sanitize-readers.sh [EXECUTIONS]        20000 unless told otherwise
#
# Needs what scripts/fuzz-campaign.sh does: a nightly toolchain, a C++ compiler, cargo-fuzz.
set -euo pipefail
cd "$(dirname "$0")/.."
RUNS="${1:-20000}" scripts/fuzz-campaign.sh 60 \
    las laz e57 npy npz gzip zip depth-image color-image features kept-pairs head network lits
