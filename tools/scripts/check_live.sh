#!/usr/bin/env bash
# Serves a run by websocket and reads it as a viewer does; see check_live.py.
set -euo pipefail
cd "$(dirname "$0")/../.."

. tools/scripts/python_tools.sh
python_tools check_live.sh
mkdir -p target/live
rm -f target/live/other
if [ -n "${CFMMR_BUILT:-}" ]; then
  cp target/release/cfmmr target/live/other
fi
# Whatever ends this: nobody is to be left with the program that is not optimised.
restore() {
  if [ -f target/live/other ]; then
    mv -f target/live/other target/release/cfmmr
  else
    rm -f target/release/cfmmr
  fi
}
trap restore EXIT
# Not optimised: fast enough for one robot. By way of a test, of which the libraries were built for.
cargo test --no-run --quiet --locked --release --package host-sim --test dashboard --features live \
  --config profile.release.package.host-sim.opt-level=0
cp target/release/cfmmr target/live/cfmmr
# The one that all other checks use.
trap - EXIT
restore
if [ -z "${CFMMR_BUILT:-}" ]; then
  cargo build --locked --release --package host-sim --bin cfmmr
fi
timeout 600 "$python" tools/scripts/check_live.py target/live/cfmmr
