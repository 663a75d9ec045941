#!/usr/bin/env bash
# The rows of docs/ablation.md on scans of other kinds than RGB-D: for every part that is switched off, the share of
# pairs right in each set, and scans placed wrongly, as scripts/truth-sets.sh counts them. Existing results are reused.
#
# Usage: ablation-kinds.sh SCANWEAVE OUT SET[:MAX_TRANSLATION[:MAX_ROTATION_DEG[:WITHIN]]]...      needs jq
set -euo pipefail
here=$(dirname "$0")
scanweave=$1 out=$2
shift 2
verification=registration.verification strategy=registration.strategy
rows=(
    "full|"
    "without several hypotheses|--set $verification.hypotheses=1"
    "without alignment of hypotheses|--set $verification.align_rounds=0"
    "without free space|--set $verification.free_space=false"
    "without viewpoint reliability|--set $verification.viewpoint_reliability=false"
    "without localizability|--set $verification.localizability=false"
    "without chance inliers|--set $verification.chance_inliers=false"
    "without noise level|--set $verification.noise_level=false"
    "without cycle consistency|--set $strategy.cycle_consistency=false"
    "without retrieval rounds|--set $strategy.retrieval_rounds=0"
    "without trials|--set $strategy.trials=false"
    "without closing loops|--set $strategy.close_loops=false"
    "without multiview ICP|--set registration.multiview_icp.enabled=false"
    "with RANSAC|--set registration.estimator.kind=ransac --set registration.estimator.hypotheses=1000"
)
printf '| default'
for set in "$@"; do printf ' | %s' "$(basename "${set%%:*}")"; done
printf ' |\n|---'
for _ in "$@"; do printf '|--:'; done
printf '|\n'
for row in "${rows[@]}"; do
    IFS='|' read -r name settings <<<"$row"
    place="$out/${name// /_}"
    SETTINGS="$settings" "$here/truth-sets.sh" "$scanweave" "$place" "$@" >/dev/null
    printf '| %s' "$name"
    for set in "$@"; do
        jq -r '.judgement as $j | " | \(1000 * $j.right_pairs / $j.judged_pairs | round / 10) (\($j.wrongly_placed | length))"' \
            "$place/$(basename "${set%%:*}").errors.json" | tr -d '\n'
    done
    printf ' |\n'
done
