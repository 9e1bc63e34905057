#!/usr/bin/env bash
# Mutants of meaning: changes core-algos in small ways and counts the changes that the tests detect; see --help.
set -euo pipefail
cd "$(dirname "$0")/../.."
exec cargo run --quiet --release --manifest-path tools/mutants/Cargo.toml -- "$@"
