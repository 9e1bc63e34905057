#!/usr/bin/env bash
# Serves a live run by websocket and reads the messages as a viewer does; see check_live.py.
set -euo pipefail
cd "$(dirname "$0")/../.."

. tools/scripts/python_tools.sh
python_tools check_live.sh
[ -n "${CFMMR_BUILT:-}" ] || cargo build --locked --release --package cfmmr --all-features
timeout 600 "$python" tools/scripts/check_live.py target/release/cfmmr
