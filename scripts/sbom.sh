#!/usr/bin/env bash
# Writes a software bill of materials, CycloneDX 1.5 as JSON, to stdout: every crate that the command links, with
# its version, licence, source and checksum, and which needs which. Tools of the build and of the tests, and
# macros, which only run while it is compiled, are left out. The same sources give the same bytes. Needs jq.
#
# Usage: sbom.sh [TARGET]
#   TARGET   a Rust target such as x86_64-pc-windows-msvc; default: this machine's
set -euo pipefail
cd "$(dirname "$0")/.."
target="${1:-$(rustc -vV | sed -n 's/^host: //p')}"
work="$(mktemp -d)"
trap 'rm -rf "$work"' EXIT
cargo metadata --locked --format-version 1 --filter-platform "$target" >"$work/metadata"
cargo tree --locked --package scanweave --target "$target" --edges normal,no-proc-macro --prefix none \
    --no-dedupe --format '{p}' | awk '{print $1 " " substr($2, 2)}' | sort -u | jq -R . | jq -s . >"$work/linked"
# Checksums of the registry's archives, as "name version" to digest.
awk -F'"' '/^name = /{n=$2} /^version = /{v=$2} /^checksum = /{print n " " v "\t" $2}' Cargo.lock |
    jq -R 'split("\t") | {(.[0]): .[1]}' | jq -s 'add' >"$work/checksums"
jq -S --slurpfile linked "$work/linked" --slurpfile checksums "$work/checksums" '
  def key: "\(.name) \(.version)";
  def ref: "pkg:cargo/\(.name)@\(.version)";
  ($linked[0] | map({(.): true}) | add) as $is_linked
  | (.packages | map(select($is_linked[key]))) as $packages
  | ($packages | map({(.id): ref}) | add) as $refs
  | ($packages[] | select(.name == "scanweave")) as $root
  | {
      bomFormat: "CycloneDX",
      specVersion: "1.5",
      version: 1,
      metadata: {component: {
        type: "application", "bom-ref": ($root | ref), name: $root.name, version: $root.version,
        licenses: [{expression: $root.license}]
      }},
      components: ($packages | map(select(.name != "scanweave") | {
        type: "library", "bom-ref": ref, name, version, purl: ref,
        # An old spelling of OR; a crate without a name of its licence has a file of it.
        licenses: [if .license then {expression: (.license | gsub(" */ *"; " OR "))} else {license: {name: "in its file \(.license_file)"}} end],
        hashes: [$checksums[0][key] // empty | {alg: "SHA-256", content: .}],
        externalReferences: [.repository // empty | {type: "vcs", url: .}]
      }) | sort_by(."bom-ref")),
      dependencies: ([.resolve.nodes[] | select($refs[.id])
        | {ref: $refs[.id], dependsOn: ([.deps[] | select(any(.dep_kinds[]; .kind == null)) | $refs[.pkg] // empty] | unique)}] | sort_by(.ref))
    }' "$work/metadata"
