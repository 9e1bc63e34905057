# Sourced: a virtual environment below target/ with the packages of requirements.txt.
#
#   python_tools NAME    sets $python; NAME is the prefix of errors

python_tools() {
  local environment=target/python wanted=tools/scripts/requirements.txt
  python=$environment/bin/python
  mkdir -p target
  # One process installs, others wait.
  {
    flock 9
    cmp -s "$wanted" "$environment/requirements.txt" && return
    { [ -x "$python" ] || python3 -m venv "$environment"; } &&
      "$environment/bin/pip" install --quiet --disable-pip-version-check -r "$wanted" &&
      cp "$wanted" "$environment/requirements.txt" || {
      echo "$1: the packages of $wanted could not be installed: that needs Python 3 with venv and pip" \
        "(Debian: apt-get install python3-venv python3-pip)" >&2
      exit 1
    }
  } 9>target/python.lock
}
