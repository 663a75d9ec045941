#!/usr/bin/env bash
# The readers that stand on crates with `unsafe` code (LAZ, E57, PNG, JPEG, deflate, safetensors, NumPy arrays)
# under the address sanitizer: the whole corpus that there is, then new files, so many executions of each kind
# in all, and ten minutes at most.
#
#   scripts/sanitize-readers.sh [EXECUTIONS]        20000 unless told otherwise
#
# Needs what scripts/fuzz-campaign.sh does: a nightly toolchain, a C++ compiler, cargo-fuzz.
set -euo pipefail
cd "$(dirname "$0")/.."
RUNS="${1:-20000}" scripts/fuzz-campaign.sh 600 \
    las laz e57 npy npz gzip zip depth-image color-image features kept-pairs pair-shard head network lits
