#!/usr/bin/env bash
# Prints flash (code and constants) and RAM (static variables) of both images as a table. The available RAM is that of
# memory.x without the stack.
set -euo pipefail
cd "$(dirname "$0")/../.."
target=thumbv7em-none-eabihf
command -v readelf >/dev/null || {
  echo "image_sizes.sh: readelf is missing: install binutils" >&2
  exit 1
}

echo "| image | flash, KiB of 1024 | variables, KiB of 80 |"
echo "|---|---|---|"
for board in axle beam; do
  cargo build --quiet --locked --profile image --package firmware-$board --target $target
  # Segments: type, offset, virtual and physical address, size in file and in memory.
  readelf --segments --wide target/$target/image/firmware-$board |
    while read -r type _ virtual physical file memory _; do
      if [ "$type" = LOAD ]; then echo $((virtual)) $((physical)) $((file)) $((memory)); fi
    done | awk -v name="firmware-$board" '
      $2 < 536870912 { flash += $3 }
      $1 >= 536870912 { ram += $4 }
      END { printf "| %s | %.1f | %.1f |\n", name, flash / 1024, ram / 1024 }'
done
