#!/usr/bin/env bash
# The compiler, with the coverage of fuzz.sh --fast for the project's own crates.
set -euo pipefail
case " $* " in
*" --crate-name cfmmr_fuzz "* | *" --crate-name core_algos "* | *" --crate-name host_sim "* | *" --crate-name firmware_common "* | *" --crate-name plant "* | *" targets/"*)
  # One flag a word.
  # shellcheck disable=SC2086
  exec "$@" $FUZZ_COVERAGE
  ;;
*) exec "$@" ;;
esac
