#!/usr/bin/env bash
# Compares CAN frames of the virtual boards with other implementations; see can_bits.py. Missing Python packages
# are installed into a virtual environment below target/. Arguments: [COUNT [SEED]] of the frames.
set -euo pipefail
cd "$(dirname "$0")/../../.."

. tools/scripts/python_tools.sh
# can_bits.py imports python-can and crccheck; crccheck is a dependency of cantools.
python_tools check_can_bits.sh
cargo run --locked --quiet --release --package virtual-board --example can_frames -- "$@" |
  "$python" crates/virtual-board/oracle/can_bits.py
