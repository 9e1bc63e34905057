#!/usr/bin/env bash
# Compares the core of the virtual boards with Unicorn in lockstep: five million random instructions, every encoding
# in the images, and sequences of the images' instructions; see lockstep.py and stretches.py. If Unicorn is missing, it
# is installed into a virtual environment below target/. Two processes share the work.
set -euo pipefail
cd "$(dirname "$0")/../../.."

built=target/thumbv7em-none-eabihf
# The images are built again, because those in target/ may have been built with other features.
for package in firmware-{axle,beam,bench}; do
  cargo build --locked --quiet --target thumbv7em-none-eabihf --profile image --package "$package"
done
images=("$built"/image/firmware-{axle,beam,bench})

. tools/scripts/python_tools.sh
python_tools check_lockstep.sh
cargo build --locked --quiet --release --package virtual-board --examples

lockstep() {
  "$python" crates/virtual-board/oracle/lockstep.py --instructions 2500000 --seed "$1" --part "$1" 2 "${images[@]}"
}
lockstep 0 &
beside=$!
status=0
lockstep 1 || status=1
"$python" crates/virtual-board/oracle/stretches.py "${images[@]}" || status=1
wait "$beside" || status=1
exit "$status"
