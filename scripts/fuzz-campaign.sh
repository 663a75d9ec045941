#!/usr/bin/env bash
# Fuzzes the reader of every kind of file (fuzz/, with libFuzzer and the address sanitizer), then damages whole
# files without instrumentation (crates/scanweave-core/tests/mutations). Prints a table; fails where something
# was found, which then lies in fuzz/artifacts/KIND/.
#
#   scripts/fuzz-campaign.sh [SECONDS [KIND…]]      300 seconds for every kind unless told otherwise
#
# Needs a nightly toolchain, a C++ compiler and cargo-fuzz (`cargo install cargo-fuzz`). Corpora stay in
# fuzz/corpus/, so that a later campaign goes on from them. All cores work, one kind on each: with two cores
# a campaign takes SECONDS x 44 kinds x 2 (fuzzing, damaging) / 2 cores, by default 3 h 40 min. On two cores that
# others worked on too, 20 seconds gave 1.5 million executions with the sanitizer and 15.8 million without: 10^8 in
# all take 120 seconds a kind (1 h 30 min), 10^8 with the sanitizer 1400 (17 h).
# RUNS=n in the environment ends each kind after so many executions, and leaves the damaging out.
set -euo pipefail
cd "$(dirname "$0")/.."
seconds="${1:-300}"
[[ $# == 0 ]] || shift
target_dir="${CARGO_TARGET_DIR:-target}"
fuzz_dir="${SCANWEAVE_FUZZ_TARGET_DIR:-fuzz/target}"
mapfile -t kinds < <(if [[ $# -gt 0 ]]; then printf '%s\n' "$@"; else cargo +nightly fuzz list; fi)

echo "== whole files by the project's writers"
SCANWEAVE_SEEDS="$PWD/fuzz/corpus" CARGO_TARGET_DIR="$target_dir" \
    cargo test --release --quiet -p scanweave-core --test mutations whole_files

echo "== programs with the address sanitizer"
if [[ $# -gt 0 ]]; then
    for kind in "${kinds[@]}"; do cargo +nightly fuzz build --target-dir "$fuzz_dir" "$kind"; done
else
    cargo +nightly fuzz build --target-dir "$fuzz_dir"
fi

work="$(mktemp -d "$([[ -d /dev/shm ]] && echo /dev/shm || echo /tmp)/fuzz-campaign.XXXXXX")"
trap 'rm -rf "$work"' EXIT
host="$(rustc +nightly -vV | sed -n 's/^host: //p')"
export seconds work programs="$fuzz_dir/$host/release"

# One kind; what libFuzzer says goes to a log. A gigabyte of memory, half a gigabyte at once, twenty seconds.
fuzz() {
    local kind="$1"
    mkdir -p "fuzz/corpus/$kind" "fuzz/artifacts/$kind" "$work/$kind"
    TMPDIR="$work/$kind" "$programs/$kind" "fuzz/corpus/$kind" -max_total_time="$seconds" -runs="${RUNS:--1}" \
        -rss_limit_mb=1024 -malloc_limit_mb=512 -timeout=20 -print_final_stats=1 \
        -artifact_prefix="fuzz/artifacts/$kind/" >"$work/$kind.log" 2>&1 || touch "$work/$kind.found"
    rm -rf "${work:?}/$kind"
}
export -f fuzz
echo "== fuzzing, $seconds s for each of ${#kinds[@]} kinds"
printf '%s\n' "${kinds[@]}" | xargs -P "$(nproc)" -I{} bash -c 'fuzz {}'

total=0
found=0
printf '%-16s %12s %8s %8s %8s %8s\n' kind executions exec/s edges features corpus
for kind in "${kinds[@]}"; do
    log="$work/$kind.log"
    stat() { sed -n "s/^stat::$1: *//p" "$log" | tail -1; }
    last() { grep -oE "$1: [0-9]+" "$log" | tail -1 | grep -oE '[0-9]+' || true; }
    executions="$(stat number_of_executed_units)"
    corpus="$(find "fuzz/corpus/$kind" -type f | wc -l)"
    printf '%-16s %12s %8s %8s %8s %8s' "$kind" "${executions:-?}" "$(stat average_exec_per_sec)" \
        "$(last cov)" "$(last ft)" "$corpus"
    total=$((total + ${executions:-0}))
    if [[ -e "$work/$kind.found" ]]; then
        found=$((found + 1))
        printf '  FOUND %s\n' "$(grep -E 'panicked at|SUMMARY|ERROR: libFuzzer' "$log" | head -2 | tr '\n' ' ')"
        tail -n 40 "$log" >"fuzz/artifacts/$kind/last.log"
    else
        echo
    fi
done
echo "$total executions, ${#kinds[@]} kinds, $found with findings"

[[ -z "${RUNS:-}" ]] || exit "$((found > 0))"
echo "== damaged files without instrumentation, $seconds s for each kind"
SCANWEAVE_MUTATION_SECONDS="$seconds" SCANWEAVE_MUTATION_KINDS="$(IFS=,; echo "${kinds[*]}")" \
    CARGO_TARGET_DIR="$target_dir" cargo test --release --quiet -p scanweave-core --test mutations damaged_files -- --nocapture
[[ "$found" == 0 ]]
