#!/usr/bin/env bash
# Everything that must hold before a change lands; people and CI run the same.
set -euo pipefail
cd "$(dirname "$0")"

step() { printf '\n== %s\n' "$*"; }

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

step "formatting"
cargo fmt --all --check
step "clippy"
cargo clippy --locked --workspace --all-targets -- -D warnings
step "documentation"
RUSTDOCFLAGS="-D warnings" cargo doc --locked --workspace --no-deps --quiet
step "tests"
cargo test --locked --workspace
step "firmware for $target"
images=(--locked --release --package firmware-axle --package firmware-beam --target "$target")
cargo clippy "${images[@]}" --package firmware-common --package core-algos --features core-algos/hil \
  -- -D warnings
cargo build "${images[@]}"
step "all passed"
