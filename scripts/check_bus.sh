#!/usr/bin/env bash
# Compares the boards' message codec with cantools; see check_dbc.py. cantools is put into a virtual
# environment below target/ if it is not there.
set -euo pipefail
cd "$(dirname "$0")/.."

python=target/python
if ! "$python/bin/python" -c 'import cantools' 2>/dev/null; then
  python3 -m venv "$python" && "$python/bin/pip" install --quiet cantools || {
    echo "check_bus.sh: cantools could not be installed: it needs Python 3 with venv and pip" \
      "(Debian: apt-get install python3-venv python3-pip)" >&2
    exit 1
  }
fi
cargo build --locked --release --package host-sim
"$python/bin/python" scripts/check_dbc.py target/release/cfmmr "$@"
