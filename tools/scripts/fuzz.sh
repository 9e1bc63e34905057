#!/usr/bin/env bash
# Fuzzes all readers of external bytes and text, with libFuzzer and the pinned toolchain.
#
#   tools/scripts/fuzz.sh [--fast] [--runs N] [TARGET...]     default: every target, few runs
#
# --fast is for long runs: optimised, coverage of the project's crates only and no traces of
# comparisons, for two to four times as many runs per second.
#
# A run is repeatable: it starts from tools/fuzz/seeds with a fixed seed. A failing input is kept in
# tools/fuzz/artifacts; pass its path to the target's program to repeat the failure.
set -euo pipefail
cd "$(dirname "$0")/../.."

fast=
if [ "${1:-}" = --fast ]; then
  fast=1
  shift
fi
runs=
if [ "${1:-}" = --runs ]; then
  [[ "${2:-}" =~ ^[1-9][0-9]*$ ]] || {
    echo "fuzz.sh: --runs ${2:-}: must be a number of runs, at least 1" >&2
    exit 2
  }
  runs=$2
  shift 2
fi
all=$(cd tools/fuzz/targets && printf '%s\n' *.rs | sed 's/\.rs$//')
for name in "$@"; do
  [ -f "tools/fuzz/targets/$name.rs" ] || {
    echo "fuzz.sh: $name: must be one of" $all >&2
    exit 2
  }
done
if ! command -v c++ >/dev/null; then
  echo "fuzz.sh: a C++ compiler is missing, libFuzzer is written in it: install g++" >&2
  exit 1
fi

# Flags of `cargo fuzz` without the address sanitizer, which needs another toolchain and finds nothing in
# code without `unsafe`. With a named target, build scripts are not instrumented.
target=$(rustc -vV | sed -n 's/^host: //p')
coverage="-Cpasses=sancov-module"
for flag in level=4 inline-8bit-counters pc-table; do
  coverage+=" -Cllvm-args=-sanitizer-coverage-$flag"
done
directory=target/fuzz
if [ -n "$fast" ]; then
  directory=target/fuzz-fast
  # Cargo calls the wrapper with the compiler's path as first argument.
  export RUSTC_WRAPPER="$PWD/tools/scripts/fuzz_rustc.sh" FUZZ_COVERAGE=$coverage
  export RUSTFLAGS="--cfg fuzzing" CARGO_PROFILE_RELEASE_OPT_LEVEL=3
else
  export RUSTFLAGS="--cfg fuzzing $coverage -Cllvm-args=-sanitizer-coverage-trace-compares"
fi
cargo build --quiet --locked --release --manifest-path tools/fuzz/Cargo.toml --target "$target" --target-dir "$directory"

# Edges: reached transitions between blocks of code; features also count how often.
echo "| target | runs | edges | features | seconds |"
echo "|---|---|---|---|---|"
mkdir -p tools/fuzz/artifacts
found=$(mktemp -d)
trap 'rm -rf "$found"' EXIT
for name in ${*:-$all}; do
  mkdir "$found/$name"
  # A scenario, an equilibrium of the frame or a save takes milliseconds.
  case $name in
    scenario | eval | params) few=3000 ;;
    *) few=50000 ;;
  esac
  # The parameters in a log have two thousand characters.
  [ "$name" = log ] && length=8192 || length=1024
  start=$SECONDS
  if ! "$directory/$target/release/$name" -runs="${runs:-$few}" -seed=1 -max_len=$length ${fast:+-entropic=0} -timeout=20 -rss_limit_mb=1024 \
    -artifact_prefix="tools/fuzz/artifacts/$name-" "$found/$name" "tools/fuzz/seeds/$name" >"$found/$name.log" 2>&1; then
    grep -A4 panicked "$found/$name.log" >&2 || tail -20 "$found/$name.log" >&2
    echo "fuzz.sh: $name failed; the input is $(ls -t tools/fuzz/artifacts/"$name"-* | head -1)" >&2
    exit 1
  fi
  awk -v name="$name" -v seconds=$((SECONDS - start)) '
    /DONE/ {
      runs = substr($1, 2)
      for (i = 1; i < NF; i++) { if ($i == "cov:") edges = $(i + 1); if ($i == "ft:") features = $(i + 1) }
    }
    END { printf "| %s | %d | %d | %d | %d |\n", name, runs, edges, features, seconds }' "$found/$name.log"
done
