#!/usr/bin/env bash
# Installs Chromium on Debian or Ubuntu, for the test of the report page. Does nothing if Chromium is installed.
set -euo pipefail

found() {
  command -v chromium || command -v chromium-browser || command -v google-chrome
}

fail() {
  echo "install_chromium.sh: $*" >&2
  echo "install_chromium.sh: install chromium by hand, so that 'chromium' is on the path" >&2
  exit 1
}

found >/dev/null && exit 0
command -v apt-get >/dev/null || fail "this machine has no apt-get"
[ "$(id -u)" = 0 ] && sudo="" || sudo=sudo
[ -z "$sudo" ] || command -v sudo >/dev/null || fail "installing a package needs root"
$sudo apt-get update -qq || fail "apt-get update failed"
DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq --no-install-recommends chromium >/dev/null ||
  fail "apt-get install failed"
found >/dev/null || fail "the installed package has no chromium on the path"
