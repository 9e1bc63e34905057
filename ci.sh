#!/usr/bin/env bash
# Everything that must hold before a change lands; people and CI run the same.
set -euo pipefail
cd "$(dirname "$0")"
# Each thing is built once here; what helps the next build costs time.
export CARGO_INCREMENTAL=0

# Each with the seconds that went by before it.
step() { printf '\n== %s (%s s)\n' "$*" "$SECONDS"; }

if ! command -v cargo >/dev/null; then
  echo "ci.sh: cargo is missing: install Rust with rustup (https://rustup.rs)" >&2
  exit 1
fi
target=thumbv7em-none-eabihf
if ! rustc --print target-libdir --target "$target" 2>/dev/null | xargs test -d; then
  step "installing the Rust target $target"
  rustup target add "$target" || {
    echo "ci.sh: the Rust target $target is missing: rustup target add $target" >&2
    exit 1
  }
fi

step "emulator"
tools/scripts/install_qemu.sh

step "formatting"
cargo fmt --all --check
cargo fmt --manifest-path tools/fuzz/Cargo.toml --check
rustfmt --edition 2024 --check tools/rigless/src/main.rs
step "clippy"
# With the feature that the default leaves out; the builds below are without it.
cargo clippy --locked --workspace --all-targets --features host-sim/live -- -D warnings
# The virtual boards without the robot's parts.
cargo clippy --locked --package virtual-board --all-targets -- -D warnings
step "documentation"
RUSTDOCFLAGS="-D warnings" cargo doc --locked --workspace --no-deps --quiet
step "firmware for $target"
images=(--locked --profile image --package firmware-axle --package firmware-beam --target "$target")
for features in "" hil emulated; do
  cargo clippy "${images[@]}" --package firmware-common --features "$features" -- -D warnings
  RUSTDOCFLAGS="-D warnings" cargo doc "${images[@]}" --package firmware-common --no-deps --quiet \
    --features "$features"
  cargo build "${images[@]}" --features "$features"
done
step "no panic in any node step"
tools/scripts/check_no_panic.sh
step "instruction counts"
tools/scripts/count_instructions.py
step "tests"
# `hil` adds the tests of the link protocol, `devices` those of the robot's parts.
cargo test --locked --workspace --exclude host-sim --features core-algos/hil,virtual-board/devices
# As it is used, and with the dependencies of the steps below: a third of the time.
cargo test --locked --release --package host-sim
# Built by the tests. A build by itself leaves out what only tests want of the libraries, and takes two
# minutes more.
export CFMMR_BUILT=1
step "pictures, tables and numbers of the documentation"
tools/scripts/test_regenerate.py
tools/scripts/regenerate.py --check
step "hostile input"
tools/scripts/fuzz.sh
step "bus description against cantools"
tools/scripts/check_bus.sh
step "logs against the Python reader of MCAP"
tools/scripts/check_mcap.sh
step "live view against a websocket client"
tools/scripts/check_live.sh
step "report pages in Chromium"
tools/scripts/check_report.sh
step "the paper's experiment on emulated boards"
hil() {
  timeout 600 target/release/cfmmr hil --emulated --compare --out target/hil "$@" | grep -A1 "ticks ("
}
hil --log target/hil/run.mcap
target/release/cfmmr replay target/hil/run.mcap | grep "identical over"
hil --no-rps
hil --link uart --stop-after 2
step "the images that users flash, on virtual boards"
timeout 900 target/release/cfmmr hil --virtual --out target/virtual | grep -A4 "^board "
step "the virtual boards' core against Unicorn in lockstep"
crates/virtual-board/oracle/check_lockstep.sh
step "the virtual boards' core against QEMU on the instruction counts"
crates/virtual-board/oracle/qemu.py
step "faults on virtual boards"
timeout 900 target/release/cfmmr faults --virtual --quick --check | tail -3
step "frames of the virtual bus against other implementations"
crates/virtual-board/oracle/check_can_bits.sh 2000
step "faults on emulated boards"
timeout 600 target/release/cfmmr faults --emulated --check --only "board resets" --only freezes \
  --only corrupts --only "encoder stuck" --only "encoder missing" --only "gyro off" --only "motor stuck" \
  --only "supply dips" --only "ends by itself" --only "rear board hangs" | tail -5
step "calibration of emulated boards, kept in their flash"
rm -rf target/calibrated
timeout 300 target/release/cfmmr calibrate imu --emulated --yes --flash target/calibrated | grep "written to"
timeout 60 target/release/cfmmr params list --emulated --flash target/calibrated | grep -A3 gyro_gain | grep stored
step "serial ports"
tools/scripts/check_serial_ports.py --stop-after 1 | grep "identical"
step "all passed"
