#!/usr/bin/env bash
# Lets the system calls that write fail, or the program be killed there, one place after the other, and looks
# at what is left: an error of one line with exit code 5 and no temporary file; after a kill, no file that is
# half-written; and in both cases a next run that succeeds and sweeps. Needs Linux and strace.
#
# Usage: fault-injection.sh [PROGRAM [EVERY [COMMAND...]]]
#   PROGRAM   default target/release/scanweave
#   EVERY     take only every n-th place (default 1: all)
#   COMMAND   of register, replace (register --force over another result), describe, benchmark, train
#             (default: all)
set -euo pipefail
cd "$(dirname "$0")/.."
program="$(realpath "${1:-target/release/scanweave}")"
every="${2:-1}"
commands=("${@:3}")
[[ ${#commands[@]} -gt 0 ]] || commands=(register replace describe benchmark train)
command -v strace >/dev/null || { echo "strace is not installed" >&2; exit 2; }

work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cd "$work"
"$program" synth -q --noise 0.3 --scans 2 -o set
cat >suite.toml <<'TOML'
name = "faults"
keypoints = [150]
computed_keypoints = 150
seeds = [0]
[[datasets]]
name = "made"
synthetic = { scans = 2, rooms = 1, width = 120, height = 90, frames_per_scan = 2, voxel_m = 0.03 }
synthetic_seeds = [3]
benchmarks = [{ name = "all", protocol = "scannet" }]
[[methods]]
name = "default"
preset = "default"
TOML
cat >train.toml <<'TOML'
[train]
epochs = 2
clusters = 4
crop_min = 120
crop_max = 220
validate_every = 1
[descriptor.keypoints]
count = 250
[[scenes]]
folders = ["set"]
[[synth]]
split = "valid"
seeds = [9]
rooms = 1
scans = 3
frames_per_scan = 1
TOML

# One thread, so that the n-th call is the same in every run: strace counts the calls of each thread apart.
run() {
    local trace=("${@:2}")
    case "$1" in
    register) "${trace[@]}" "$program" register set -o out -q --threads 1 --force ;;
    replace) "${trace[@]}" "$program" register set -o out -q --threads 1 --force --seed 2 --trajectory csv ;;
    describe) "${trace[@]}" "$program" describe set -o out -q --threads 1 --force ;;
    benchmark) "${trace[@]}" "$program" benchmark --suite suite.toml -o out -q --threads 1 ;;
    train) "${trace[@]}" "$program" train --config train.toml -o out -q --threads 1 --force ;;
    esac
}

if [[ " ${commands[*]} " == *" replace "* ]]; then
    "$program" register set -o old -q --threads 1 --seed 1
fi

failed=0
complain() {
    echo "FAILED: $*" >&2
    failed=$((failed + 1))
}
# Temporary files and locks that lie in the output.
litter() { [[ ! -d out ]] || find out -name '.scanweave*' | head -n 3; }
# What marks a whole result must never stand for a part of one.
whole() {
    [[ -d out ]] || return 0
    case "$1" in
    register | replace) [[ ! -e out/poses.json ]] || "$program" export -q --trajectory tum -o tum out ;;
    describe) find out -name '*.npz' -not -path '*/.*' -exec "$program" inspect -q {} + ;;
    benchmark) find out -name '*.json' -not -name '.*' -exec jq -e . {} + >/dev/null ;;
    train) find out -name '*.safetensors' -not -name '.*' -exec "$program" inspect -q {} + ;;
    esac
}

# What lies in the output before the command.
prepare() {
    rm -rf out
    [[ "$1" != replace ]] || cp -r old out
}
# A failed replacement leaves the old result, or none at all; the folder is read with the cache apart.
kept() {
    [[ ! -e out/poses.json ]] || cmp -s out/poses.json old/poses.json || return 1
    [[ ! -e out/poses.json ]] || diff -r -x cache out old >/dev/null
}

one() { # COMMAND CALL WHAT PLACE
    local command="$1" call="$2" what="$3" place="$4" code=0
    local where="$command, $call $place: $what"
    prepare "$command"
    run "$command" strace -f -qq -o trace -e "trace=$call" -e "inject=$call:$what:when=$place" >said 2>&1 || code=$?
    case "$what" in
    signal=*) [[ $code -eq 137 || $code -eq 0 ]] || complain "$where: exit code $code" ;;
    *)
        # Some calls may fail without harm: a folder that cannot be synced, a lock that stays.
        [[ $code -eq 5 || $code -eq 0 ]] || complain "$where: exit code $code: $(tail -n 1 said)"
        # The message itself may be the write that fails.
        [[ $code -ne 5 ]] || grep -q '^error: ' said || grep -q 'write(2,.*INJECTED' trace ||
            complain "$where: no error is told"
        # A benchmark names the cell on a line of its own.
        [[ $(grep -vc ' in the cell ' said) -le 1 ]] || complain "$where: says more than one line: $(head -n 1 said)"
        [[ $command != replace || $code -ne 5 ]] || kept || complain "$where: the old result is not what it was"
        [[ $call == unlink || -z "$(litter)" ]] || complain "$where: left $(litter)"
        ;;
    esac
    whole "$command" >said 2>&1 || complain "$where: $(tail -n 1 said)"
    run "$command" >said 2>&1 || complain "$where: the next run: $(tail -n 1 said)"
    [[ -z "$(litter)" ]] || complain "$where: the next run left $(litter)"
}

for command in "${commands[@]}"; do
    places=0
    for call in write fsync rename renameat unlink mkdir; do
        prepare "$command"
        run "$command" strace -f -qq -o trace -e "trace=$call" >/dev/null 2>&1
        # The thread that makes the most of these calls has the last place.
        last="$(awk '{n[$1]++} END {m = 0; for (t in n) if (n[t] > m) m = n[t]; print m}' trace)"
        for ((place = 1; place <= last; place += every)); do
            one "$command" "$call" error=ENOSPC "$place"
            one "$command" "$call" signal=SIGKILL "$place"
            places=$((places + 2))
        done
    done
    echo "$command: $places faults"
done
if [[ $failed -gt 0 ]]; then
    echo "$failed complaints" >&2
    exit 1
fi
