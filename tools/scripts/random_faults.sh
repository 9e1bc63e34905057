#!/usr/bin/env bash
# Tests the in-process robot under random faults: random_faults.sh RUNS [FIRST_SEED]
set -euo pipefail
cd "$(dirname "$0")/../.."
runs=${1:?random_faults.sh: give the number of runs}
RANDOM_FAULT_RUNS=$runs RANDOM_FAULT_SEED=${2:-1} \
  cargo test --locked --release --package cfmmr --all-features --test suite -- random_faults --nocapture
