#!/usr/bin/env bash
# Compares the boards' message codec with cantools; see check_dbc.py. Installs cantools in a virtual
# environment below target/ if needed.
set -euo pipefail
cd "$(dirname "$0")/../.."

. tools/scripts/python_tools.sh
python_tools check_bus.sh
[ -n "${CFMMR_BUILT:-}" ] || cargo build --locked --release --package cfmmr --all-features
"$python" tools/scripts/check_dbc.py target/release/cfmmr "$@"
