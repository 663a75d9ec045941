#!/usr/bin/env bash
# Every dependency, of every feature, is under a licence that deny.toml allows.
# A stand-in for `cargo deny check licenses` where cargo-deny is not installed. Needs jq.
set -euo pipefail
cd "$(dirname "$0")/.."
# The lists of deny.toml, so that there is one place to change.
allowed="$(sed -n '/^allow = \[/,/^\]/p' deny.toml | grep -o '"[^"]*"' | tr -d '"' | jq -R . | jq -s .)"
clarified="$(sed -n 's/^crate = "\(.*\)"$/\1/p' deny.toml | jq -R . | jq -s .)"
refused="$(cargo metadata --locked --format-version 1 --all-features | jq -r --argjson allowed "$allowed" --argjson clarified "$clarified" '
  # Every AND part needs one allowed alternative; stricter than SPDX where no brackets say otherwise.
  def accepted:
    gsub("[()]"; "") | gsub(" */ *"; " OR ") | gsub(" WITH LLVM-exception"; "")
    | split(" AND ") | all(split(" OR ") | any(. as $l | $allowed | index($l) != null));
  .packages[]
  | select(.name as $n | $clarified | index($n) == null)
  | select((.license // "") | accepted | not)
  | "\(.name) \(.version): \(.license // "no licence stated")"')"
if [[ -n "$refused" ]]; then
    echo "licences that deny.toml does not allow:" >&2
    echo "$refused" >&2
    exit 1
fi
