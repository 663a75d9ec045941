#!/usr/bin/env bash
# Registers sets of scans whose true poses are known (FPFH) and compares: share of pairs right, wrongly placed
# scans, errors of relative poses at the scans' centres, stated against true errors. Prints a table; existing
# results are reused.
#
# Usage: truth-sets.sh SCANWEAVE OUT SET[:MAX_TRANSLATION[:MAX_ROTATION_DEG[:WITHIN]]]...      needs jq
# SET is a folder that `evaluate --truth` reads; the limits are those of a right pair, and WITHIN leaves out pairs
# whose true centres are further apart; all lengths are in the unit of the files. Settings: SETTINGS="--set key=value …"
set -euo pipefail
scanweave=$1 out=$2
shift 2
mkdir -p "$out"
echo "| set | placed | components | pairs right | placed wrong, of these above .9 | median and largest error | NEES, median and mean (0.89 and 1 expected) |"
echo "|---|--:|--:|--:|--:|--:|--:|"
for entry in "$@"; do
    IFS=: read -r set translation rotation within <<<"$entry"
    result="$out/$(basename "$set")"
    scans="$set"
    [[ -d "$set/scans" ]] && scans="$set/scans"
    # shellcheck disable=SC2086
    [[ -f "$result/poses.json" ]] ||
        "$scanweave" register -q "$scans" -o "$result" --force --set descriptor.kind=fpfh ${SETTINGS:-}
    limits=()
    [[ -n "${translation:-}" ]] && limits+=(--max-translation "$translation")
    [[ -n "${rotation:-}" ]] && limits+=(--max-rotation "$rotation")
    [[ -n "${within:-}" ]] && limits+=(--within "$within")
    "$scanweave" evaluate "$result" --truth "$set" "${limits[@]}" --json >"$result.errors.json"
    jq -r --arg name "$(basename "$set")" '
        def significant: if . == 0 or . == null then "–" else
            (pow(10; 2 - (. | log10 | floor))) as $scale | (. * $scale | round) / $scale end;
        .judgement as $j | .poses.pair_summary as $e | $j.stated_error as $s
        | "| \($name) | \(.poses.placed) of \(.poses.total) | \(.poses.components) | \($j.right_pairs) of \($j.judged_pairs) | \($j.wrongly_placed | length), \($j.confidently_wrong) | \($e.median_translation_m | significant), \($e.max_translation_m | significant) | \($s.median | significant), \($s.mean | significant) |"
    ' "$result.errors.json"
done
