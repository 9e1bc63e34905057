# Sourced: a virtual environment below target/ with the Python packages that a check needs.
#
#   python_tools NAME MODULE PACKAGE==VERSION...    sets $python; NAME is said in errors, MODULE tried

python_tools() {
  local name=$1 module=$2 environment=target/python
  shift 2
  python=$environment/bin/python
  "$python" -c "import $module" 2>/dev/null && return
  { [ -x "$python" ] || python3 -m venv "$environment"; } &&
    "$environment/bin/pip" install --quiet --disable-pip-version-check "$@" || {
    echo "$name: $* could not be installed: it needs Python 3 with venv and pip" \
      "(Debian: apt-get install python3-venv python3-pip)" >&2
    exit 1
  }
}
