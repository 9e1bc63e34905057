#!/usr/bin/env bash
# Draws the terminal dashboard of a run as SVG on standard output; see dashboard_picture.py.
#
#   dashboard_picture.sh SECONDS [ARGUMENT...]
set -euo pipefail
cd "$(dirname "$0")/../.."

. tools/scripts/python_tools.sh
python_tools dashboard_picture.sh
"$python" tools/scripts/dashboard_picture.py target/release/cfmmr "$@"
