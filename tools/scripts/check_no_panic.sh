#!/usr/bin/env bash
# Proves that no step of a node can panic or formats text: see tools/checks/src/no_panic.
set -euo pipefail
cd "$(dirname "$0")/../.."

target=thumbv7em-none-eabihf
build=(cargo build --locked --quiet --package firmware-checks --bin no-panic --profile image --target "$target")
image=target/$target/image/no-panic

if ! command -v nm >/dev/null; then
  echo "check_no_panic.sh: nm is missing: install binutils" >&2
  exit 1
fi

# The check itself must be able to fail.
if output=$("${build[@]}" --features panic 2>&1); then
  echo "check_no_panic.sh: an image with a panic linked, so the check proves nothing" >&2
  exit 1
elif ! grep -q a_node_step_can_panic <<<"$output"; then
  echo "check_no_panic.sh: the image with a panic failed for another reason:" >&2
  echo "$output" >&2
  exit 1
fi

if ! output=$("${build[@]}" 2>&1); then
  echo "$output" >&2
  echo "check_no_panic.sh: a node step can panic; to find it, look for the caller of the panic in" >&2
  echo "the assembly (cargo rustc ... -- --emit asm) or halve the calls in image.rs" >&2
  exit 1
fi

# The image must contain the nodes: without nodes, any image would link.
symbols=$(nm --demangle "$image")
for step in AxleNode::step RobotFusion::step Regulator::tick Solver::begin RelativePositionSensor::work peripheral_tick; do
  if ! grep -q "$step" <<<"$symbols"; then
    echo "check_no_panic.sh: $step is not in the image: it proves nothing" >&2
    exit 1
  fi
done
if found=$(grep -E 'core::fmt|core::panicking' <<<"$symbols"); then
  echo "check_no_panic.sh: text formatting in the node steps:" >&2
  echo "$found" >&2
  exit 1
fi
echo "no panic, no formatting in $(size "$image" | awk 'NR == 2 { print $1 }') bytes of node code"
