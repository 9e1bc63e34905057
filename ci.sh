#!/usr/bin/env bash
# Everything that must hold before a change lands; people and CI run the same.
set -euo pipefail
cd "$(dirname "$0")"
# Each thing is built once here; what helps the next build costs time.
export CARGO_INCREMENTAL=0

# Each with the seconds that went by before it.
step() { printf '\n== %s (%s s)\n' "$*" "$SECONDS"; }

# Steps that take one core go on beside others, in a process group of their own; `joined` waits for them and prints
# what they said.
aside() {
  set -m
  "$@" >target/aside.log 2>&1 &
  aside=$!
  set +m
}
joined() {
  local ended=0
  wait "$aside" || ended=$?
  cat target/aside.log
  return "$ended"
}
trap '[ -z "${aside:-}" ] || kill -- "-$aside" 2>/dev/null || true' EXIT

if ! command -v cargo >/dev/null; then
  echo "ci.sh: cargo is missing: install Rust with rustup (https://rustup.rs)" >&2
  exit 1
fi
target=thumbv7em-none-eabihf
for needed in "$target" wasm32-unknown-unknown; do
  if ! rustc --print target-libdir --target "$needed" 2>/dev/null | xargs test -d; then
    step "installing the Rust target $needed"
    rustup target add "$needed" || {
      echo "ci.sh: the Rust target $needed is missing: rustup target add $needed" >&2
      exit 1
    }
  fi
done

# Comes over the network, beside what is built.
. tools/scripts/python_tools.sh
python_tools ci.sh &
packages=$!

step "formatting"
cargo fmt --all --check
cargo fmt --manifest-path tools/fuzz/Cargo.toml --check
cargo fmt --manifest-path tools/mutants/Cargo.toml --check
step "licences, sources and versions of the dependencies"
tools/scripts/check_dependencies.py
step "clippy"
# Macros and build scripts are those of the release build, which are built anyway.
cargo clippy --locked --release --workspace --all-features --all-targets -- -D warnings
# The parts that the first command builds.
cargo clippy --locked --release --package cfmmr -- -D warnings
# The virtual boards without the robot's parts.
cargo clippy --locked --release --package virtual-board --all-targets -- -D warnings
step "documentation"
RUSTDOCFLAGS="-D warnings" cargo doc --locked --release --workspace --all-features --no-deps --quiet
step "firmware for $target"
images=(--locked --profile image --package firmware-axle --package firmware-beam --target "$target")
cargo clippy "${images[@]}" --package firmware-common -- -D warnings
RUSTDOCFLAGS="-D warnings" cargo doc "${images[@]}" --package firmware-common --no-deps --quiet
cargo build "${images[@]}"
numbers_of_the_images() {
  step "no panic in any node step"
  tools/scripts/check_no_panic.sh
  step "instruction counts"
  tools/scripts/count_instructions.py
}
aside numbers_of_the_images
step "tests"
# `link` adds the tests of the link, `devices` those of the robot's parts.
cargo test --locked --package core-algos --package declare --package firmware-common --package plant --package square-root \
  --package virtual-board --features core-algos/link,virtual-board/devices
joined
wait "$packages"
# The program of the first command; before the whole program, whose file it shares. It runs for a moment.
quick=()
for package in cfmmr output recording remote view; do
  quick+=(--config "profile.release.package.$package.opt-level=0")
done
cargo test --locked --release "${quick[@]}" --package cfmmr --test parts
# With the libraries of the steps below.
program=(--locked --release --package cfmmr --all-features)
cargo test "${program[@]}" --package host-sim --package output --package remote --package recording --package view --package web --lib
cargo test "${program[@]}" --package host-sim --test '*'
cargo test "${program[@]}" --package host-sim --doc
cargo build "${program[@]}" --package web --example native
# Built by the tests. A build by itself leaves out what only tests want of the libraries, and takes two
# minutes more.
export CFMMR_BUILT=1
checks_of_the_program() {
  step "pictures, tables and numbers of the documentation"
  tools/scripts/test_regenerate.py
  tools/scripts/regenerate.py --check
  step "attack from outside"
  tools/attack/attack.py target/release/cfmmr
  step "bus description against cantools"
  tools/scripts/check_bus.sh
  step "logs against the Python reader of MCAP"
  tools/scripts/check_mcap.sh
  step "live view against a websocket client"
  tools/scripts/check_live.sh
  step "report pages in Chromium"
  tools/scripts/check_report.sh
  step "the browser page"
  tools/scripts/check_page.sh
  step "the Python package"
  tools/scripts/check_python.sh
}
aside checks_of_the_program
step "hostile input"
tools/scripts/fuzz.sh
step "the virtual boards' core against Unicorn in lockstep"
crates/virtual-board/oracle/check_lockstep.sh
step "the same bytes in WebAssembly"
tools/scripts/check_web.sh
step "the paper's experiment with virtual boards in a session"
hil() {
  timeout 600 target/release/cfmmr hil --on virtual --compare --out target/hil "$@" | grep -A1 "ticks ("
}
hil --log target/hil/run.mcap
target/release/cfmmr replay target/hil/run.mcap | grep "identical over"
hil --no-rps --stop-after 4
step "the images that users flash, on virtual boards"
timeout 900 target/release/cfmmr posture --on virtual --out target/virtual | grep -A4 "^board "
step "faults on virtual boards"
timeout 900 target/release/cfmmr faults --on virtual --quick --check | tail -3
step "frames of the virtual bus against other implementations"
crates/virtual-board/oracle/check_can_bits.sh 2000
joined
step "all passed"
