#!/usr/bin/env bash
# Opens report pages in a headless Chromium and uses them; see check_report.py. Argument: folder for the screenshots,
# optional.
set -euo pipefail
cd "$(dirname "$0")/../.."

tools/scripts/install_chromium.sh
. tools/scripts/python_tools.sh
python_tools check_report.sh
[ -n "${CFMMR_BUILT:-}" ] || cargo build --locked --release --package cfmmr --all-features
"$python" tools/scripts/check_report.py target/release/cfmmr "$@"
