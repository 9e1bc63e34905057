#!/usr/bin/env bash
# Uses the browser page in a headless Chromium; see check_page.py, which gets the arguments. CFMMR_PAGE: the page, if it
# is built.
set -euo pipefail
cd "$(dirname "$0")/../.."
export CARGO_INCREMENTAL=0

tools/scripts/install_chromium.sh
. tools/scripts/python_tools.sh
python_tools check_page.sh
[ -n "${CFMMR_PAGE:-}" ] || bindings/web/build
"$python" tools/scripts/check_page.py "${CFMMR_PAGE:-target/web/cfmmr.html}" "$@"
