#!/usr/bin/env bash
# Mutation test: share of small changes of a folder that the tests of its crate (in core-algos: of its module) detect.
#
#   tools/scripts/mutants.sh FOLDER SHARE [OPTION...]     exits 1 below SHARE percent
#   tools/scripts/mutants.sh core-algos/src/safety 90 --shard 0/4 --sharding round-robin
#
# OPTIONs are those of cargo mutants; --shard tests a sample. Accepted equivalents: .cargo/mutants.toml.
# FILTER="safety:: node::" restricts the tests by name, for a faster lower bound.
set -euo pipefail
cd "$(dirname "$0")/../.."

folder=${1:-} share=${2:-}
case $folder in
  core-algos/src/?*) crate=(--package core-algos --features link) tests=(--lib) ;;
  crates/plant/src*) crate=(--package plant) tests=(--tests) ;;
  *) echo "mutants.sh: folder '$folder': must be core-algos/src/NAME or crates/plant/src" >&2; exit 2 ;;
esac
if [ ! -d "$folder" ] || ! [[ $share =~ ^[0-9]+$ && $share -le 100 ]]; then
  echo "mutants.sh: '$folder' must be a folder, the share '$share' a whole number from 0 to 100" >&2
  exit 2
fi
if ! command -v cargo-mutants >/dev/null; then
  echo "mutants.sh: cargo-mutants is missing: cargo install --locked cargo-mutants" >&2
  exit 1
fi

# A mutant is built and run once, so compile time matters more than speed.
export CARGO_PROFILE_TEST_OPT_LEVEL=1 CARGO_PROFILE_TEST_DEBUG=false CARGO_PROFILE_DEV_DEBUG=false
results=target/mutants/${folder//\//-} status=0
mkdir -p "$results"
read -ra filter <<<"${FILTER:-}"
cargo mutants "${crate[@]}" --file "${folder%/}/**" --output "$results" "${@:3}" -- "${tests[@]}" -- "${filter[@]}" || status=$?
# 2: mutants missed, 3: mutants timed out. Other codes are failures of cargo mutants.
((status == 0 || status == 2 || status == 3)) || exit "$status"
count() { wc -l <"$results/mutants.out/$1.txt"; }
caught=$(($(count caught) + $(count timeout))) missed=$(count missed)
((caught + missed > 0)) || { echo "mutants.sh: no mutant of $folder can be built" >&2; exit 1; }
echo "$folder: $caught caught, $missed missed, $(count unviable) unviable: $((100 * caught / (caught + missed))) %"
((100 * caught >= share * (caught + missed)))
