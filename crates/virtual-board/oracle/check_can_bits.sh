#!/usr/bin/env bash
# Compares CAN frames of the virtual boards' wire with other implementations; see can_bits.py. What it
# needs is put into a virtual environment below target/ if it is not there. COUNT and SEED may be given.
set -euo pipefail
cd "$(dirname "$0")/../../.."

. tools/scripts/python_tools.sh
# python-can is imported by cantools, crccheck is what it depends on.
python_tools check_can_bits.sh
cargo run --locked --quiet --release --package virtual-board --example can_frames -- "$@" |
  "$python" crates/virtual-board/oracle/can_bits.py
