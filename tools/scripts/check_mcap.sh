#!/usr/bin/env bash
# Reads logs with the Python reader of MCAP and compares them with the run's tables and, frame by frame,
# with cantools; see check_mcap.py. Installs the packages in a virtual environment below target/.
set -euo pipefail
cd "$(dirname "$0")/../.."

. tools/scripts/python_tools.sh
python_tools check_mcap.sh
[ -n "${CFMMR_BUILT:-}" ] || cargo build --locked --release --package cfmmr --all-features
"$python" tools/scripts/check_mcap.py target/release/cfmmr "$@"
