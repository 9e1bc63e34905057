#!/usr/bin/env bash
# Compares the core of the virtual boards with Unicorn in lockstep: ten million instructions at random, every
# encoding of the images, and stretches of the images themselves; see lockstep.py and stretches.py. Unicorn is
# put into a virtual environment below target/ if it is not there. The images must be built. Two processes
# share the work.
set -euo pipefail
cd "$(dirname "$0")/../.."

built=target/thumbv7em-none-eabihf
images=("$built/release/firmware-axle" "$built/release/firmware-beam" "$built/count/firmware-bench")
for image in "${images[@]}"; do
  if [ ! -f "$image" ]; then
    echo "check_lockstep.sh: $image is missing: cargo build-axle, cargo build-beam and" \
      "scripts/count_instructions.py build the images" >&2
    exit 1
  fi
done

. scripts/python_tools.sh
python_tools check_lockstep.sh unicorn unicorn==2.1.4
cargo build --locked --quiet --release --package virtual-board --examples

"$python" virtual-board/oracle/lockstep.py --instructions 4000000 --seed 1 "${images[@]}" &
encodings=$!
status=0
"$python" virtual-board/oracle/lockstep.py --instructions 6000000 --seed 2 || status=1
"$python" virtual-board/oracle/stretches.py "${images[@]}" || status=1
wait "$encodings" || status=1
exit "$status"
