#!/usr/bin/env bash
# The core compiles without what it must not know, and its rooms use only those below them
# (ARCHITECTURE.md, "Layers of the core"). Prints the number of packages that each crate is built from.
set -euo pipefail
cd "$(dirname "$0")/.."
packages() { cargo tree --locked -e normal --prefix none --no-dedupe -p "$@" | awk '{print $1}' | sort -u; }
core="$(packages scanweave-core)"
for unwanted in burn clap anyhow plotters indicatif scanweave; do
    if grep -qx "$unwanted" <<<"$core"; then
        echo "scanweave-core is built from $unwanted" >&2
        exit 1
    fi
done
without_training="$(packages scanweave --no-default-features)"
if grep -q '^burn' <<<"$without_training"; then
    echo "scanweave without its feature \`training\` is built from Burn" >&2
    exit 1
fi
echo "packages: $(wc -l <<<"$core") for scanweave-core, $(packages scanweave | wc -l) for scanweave, \
$(wc -l <<<"$without_training") of them without training"

# A room offers flat names; its files are private. Modules that programs can name, beside the two crates themselves:
public="$(grep -rhE '^ *pub mod ' crates/scanweave-core/src | wc -l) $(grep -rhE '^ *pub mod ' src | wc -l)"
if [[ "$public" != "14 14" ]]; then
    echo "public modules: found $public in the core and the root, expected 14 14 (ARCHITECTURE.md, \"Layers of the core\")" >&2
    exit 1
fi

# What the rooms of each layer may not name; tests at the end of a file are left out.
failed=0
forbid() {
    local rooms="$1" others="$2" room file found
    for room in $rooms; do
        while read -r file; do
            found="$(awk '/^#\[cfg\(test\)\]/{exit} !/^ *\/\//' "$file" | grep -oE "crate::($others)\b" | sort -u | tr '\n' ' ' || true)"
            if [[ -n "$found" ]]; then
                echo "$file is below what it uses: $found" >&2
                failed=1
            fi
        done < <(find "crates/scanweave-core/src/$room" "crates/scanweave-core/src/$room.rs" -name '*.rs' ! -name 'tests.rs' 2>/dev/null)
    done
}
stages='io|preprocessing|descriptor|retrieval|registration|synchronization'
above='config|result|pipeline|register'
forbid "error monitor random printable files owner atomic output_folder tensor_file" "geometry|scan|$stages|$above"
forbid "geometry" "scan|$stages|$above"
forbid "scan" "$stages|$above"
for room in io preprocessing descriptor retrieval registration synchronization; do
    forbid "$room" "$(tr '|' '\n' <<<"$stages" | grep -vx "$room" | paste -sd'|')|$above"
done
forbid "registration/pairwise registration/scan_model" "registration::(incremental|agglomerative|multiview_icp|verification)"
forbid "registration/verification" "registration::(incremental|agglomerative|multiview_icp)"
forbid "registration/multiview_icp" "registration::(incremental|agglomerative|verification)"
forbid "registration/incremental" "registration::agglomerative"
forbid "registration/agglomerative" "registration::incremental"
exit "$failed"
