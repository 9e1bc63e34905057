#!/usr/bin/env bash
# The Python package: builds the wheel, installs it into an environment of its own, and runs tests and notebooks there.
set -euo pipefail
cd "$(dirname "$0")/../.."
export CARGO_INCREMENTAL=0

package=bindings/python
environment=$PWD/target/python-package
python=$environment/bin/python
max_wheel_bytes=3000000
max_rust_packages=80

fail() {
  echo "check_python.sh: $*" >&2
  exit 1
}
command -v cargo >/dev/null || fail "cargo is missing: install Rust with rustup (https://rustup.rs)"
command -v python3 >/dev/null || fail "python3 is missing (Debian: apt-get install python3 python3-venv python3-pip)"
python3 -c 'import sys; sys.exit(sys.version_info < (3, 11))' ||
  fail "$(python3 --version) is too old: install Python 3.11 or later (https://www.python.org/downloads)"
CFMMR=${CFMMR:-$PWD/target/release/cfmmr}
[ -x "$CFMMR" ] || fail "$CFMMR is missing: cargo build --release --package cfmmr"
export CFMMR

# Everything except the wheel is installed once for each version of these files.
wanted=$(cat $package/tests/requirements.txt $package/pyproject.toml)
pip=("$python" -m pip --quiet --disable-pip-version-check install)
current=
[ ! -f "$environment/wanted.txt" ] || current=$(cat "$environment/wanted.txt")
if [ "$current" != "$wanted" ]; then
  rm -rf "$environment"
  { python3 -m venv "$environment" && "${pip[@]}" -r $package/tests/requirements.txt; } ||
    fail "the packages of $package/tests/requirements.txt could not be installed: that needs Python 3 with venv and" \
      "pip (Debian: apt-get install python3-venv python3-pip)"
fi

rm -rf target/wheels
"$environment/bin/maturin" build --release --manifest-path $package/Cargo.toml --out target/wheels \
  >target/wheel.log 2>&1 || {
  cat target/wheel.log >&2
  fail "the wheel could not be built"
}
wheel=$(echo target/wheels/cfmmr-*.whl)
if [ "$current" != "$wanted" ]; then
  "${pip[@]}" "$wheel[frames,pictures,logs,mujoco]"
  printf '%s\n' "$wanted" >"$environment/wanted.txt"
else
  "${pip[@]}" --force-reinstall --no-deps "$wheel"
fi

bytes=$(stat --format %s "$wheel")
import_ms=$(for _ in 1 2 3 4 5; do
  "$python" -c 'import time, numpy
begin = time.perf_counter()
import cfmmr
print(f"{(time.perf_counter() - begin) * 1e3:.1f}")'
done | sort -n | head -1)
packages=$(cargo tree --locked --package cfmmr-python --edges normal,build --prefix none | sed 's/ (\*)$//' |
  sort -u | wc -l)
echo "wheel $bytes bytes; import after numpy $import_ms ms; $packages Rust packages"
[ "$bytes" -le $max_wheel_bytes ] || fail "the wheel has $bytes bytes: must be at most $max_wheel_bytes"
[ "$packages" -le $max_rust_packages ] || fail "$packages Rust packages: must be at most $max_rust_packages"

# Outside of the source, so that the installed package is tested.
unset PYTHONPATH
"$python" -m pytest --quiet -p no:cacheprovider --rootdir $package/tests $package/tests

notebook='import os, sys, nbformat
from nbclient import NotebookClient
path = sys.argv[1]
place = {"metadata": {"path": os.path.dirname(path)}}
NotebookClient(nbformat.read(path, 4), timeout=600, kernel_name="python3", resources=place).execute()
print(path, "runs")'
for path in "$package"/examples/*.ipynb; do
  [ ! -e "$path" ] || "$python" -c "$notebook" "$path"
done
