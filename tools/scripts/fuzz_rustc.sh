#!/usr/bin/env bash
# Compiler wrapper that adds coverage to the project's crates, for fuzz.sh --fast.
set -euo pipefail
case " $* " in
*" --crate-name cfmmr_fuzz "* | *" --crate-name core_algos "* | *" --crate-name host_sim "* | *" --crate-name firmware_common "* | *" --crate-name plant "* | *" targets/"*)
  # One flag per word.
  # shellcheck disable=SC2086
  exec "$@" $FUZZ_COVERAGE
  ;;
*) exec "$@" ;;
esac
