#!/usr/bin/env bash
# Installs qemu-system-arm 9.0 or newer, which the emulated boards need, on Debian or Ubuntu.
# Nothing is done if a new enough one is there. Where the release's own package is too old, the
# backports suite is added, derived from the machine's own package source.
set -euo pipefail

need=9

major() { # of the QEMU found on the path, 0 without one
  qemu-system-arm --version 2>/dev/null | sed -n 's/^QEMU emulator version \([0-9]*\).*/\1/p' | grep . || echo 0
}

fail() {
  echo "install_qemu.sh: $*" >&2
  echo "install_qemu.sh: install qemu-system-arm $need.0 or newer by hand (found: version $(major); 0 is none)" >&2
  exit 1
}

[ "$(major)" -ge $need ] && exit 0
command -v apt-get >/dev/null || fail "this machine has no apt-get"
[ "$(id -u)" = 0 ] && sudo="" || sudo=sudo
[ -z "$sudo" ] || command -v sudo >/dev/null || fail "installing a package needs root"

candidate() { # major version that apt would install, from suite $1 if given
  apt-cache policy qemu-system-arm | sed -n 's/^ *\(\*\*\*\)\? *[0-9]*:\?\([0-9]*\)\.[^ ]* [0-9]*$/\2/p' | sort -rn | head -1 | grep . || echo 0
}

$sudo apt-get update -qq || fail "apt-get update failed"
suite=""
if [ "$(candidate)" -lt $need ]; then
  codename=$(. /etc/os-release && echo "${VERSION_CODENAME:-}")
  [ -n "$codename" ] || fail "the release's code name is not in /etc/os-release"
  suite=$codename-backports
  parts=/etc/apt/sources.list.d
  if sources=$(grep -lsE "^Suites:.*\b$codename\b" $parts/*.sources | head -1) && [ -n "$sources" ]; then
    # The first stanza that names the release itself, with the suite changed.
    awk -v RS= -v name="$codename" '$0 ~ "Suites:[^\n]*[ \t]" name "([ \t\n]|$)" { print; exit }' "$sources" |
      sed "s/^Suites:.*/Suites: $suite/" | $sudo tee $parts/qemu-backports.sources >/dev/null
  elif line=$(grep -hsE "^deb .* $codename main" /etc/apt/sources.list $parts/*.list | head -1) && [ -n "$line" ]; then
    sed "s/ $codename / $suite /" <<<"$line" | $sudo tee $parts/qemu-backports.list >/dev/null
  else
    fail "no package source of $codename was found to derive $suite from"
  fi
  $sudo apt-get update -qq || fail "apt-get update failed with the suite $suite"
  [ "$(candidate)" -ge $need ] || fail "the suite $suite has no qemu-system-arm $need.0 or newer"
fi
DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq --no-install-recommends \
  ${suite:+-t "$suite"} qemu-system-arm >/dev/null || fail "apt-get install failed"
[ "$(major)" -ge $need ] || fail "the installed version is still too old"
