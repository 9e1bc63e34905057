#!/usr/bin/env bash
# Compares every epoch of 60 trials and six drives on this machine and in WebAssembly.
set -euo pipefail
cd "$(dirname "$0")/../.."
export CARGO_INCREMENTAL=0

target=wasm32-unknown-unknown
if ! command -v node >/dev/null; then
  echo "check_web.sh: node is missing: install Node.js 18 or later (https://nodejs.org)" >&2
  exit 1
fi
if ! rustc --print target-libdir --target "$target" 2>/dev/null | xargs test -d; then
  echo "check_web.sh: the Rust target $target is missing: rustup target add $target" >&2
  exit 1
fi
cargo build --quiet --locked --profile web --package web --lib --target "$target"
if [ -z "${CFMMR_BUILT:-}" ]; then
  cargo build --quiet --locked --release --package web --example native
fi
target/release/examples/native >target/web.txt
node bindings/web/compare.mjs "target/$target/web/web.wasm" target/web.txt
