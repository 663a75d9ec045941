#!/usr/bin/env bash
# Holds every dependency, of every feature, against the RustSec database of known vulnerabilities and unmaintained
# crates, and against the rest of deny.toml: licences, sources, wildcards, yanked versions.
# Needs cargo-deny (`cargo install --locked cargo-deny`) and a network, or a copy of the database that was fetched
# before, and --offline.
#
# Usage: check-advisories.sh [--offline]
# Exit codes: 0 nothing found; 1 something found; 2 not run, and stderr says why.
set -euo pipefail
cd "$(dirname "$0")/.."
not_run() {
    echo "not run: $*; nothing is known about advisories" >&2
    exit 2
}
command -v cargo-deny >/dev/null || not_run "cargo-deny is not installed (cargo install --locked cargo-deny)"
fetch=()
if [[ "${1:-}" == "--offline" ]]; then
    fetch=(--disable-fetch)
else
    said="$(cargo deny fetch db 2>&1)" || not_run "the advisory database cannot be fetched: $(tail -n 1 <<<"$said")"
fi
# What could not be looked up is no finding.
code=0
said="$(cargo deny --locked check "${fetch[@]}" 2>&1)" || code=$?
if grep -q 'failed to \(load\|fetch\|open\) advisory database' <<<"$said"; then
    not_run "there is no advisory database"
fi
printf '%s\n' "$said"
[[ $code -eq 0 ]] || exit 1
