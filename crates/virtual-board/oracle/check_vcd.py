#!/usr/bin/env python3
"""Has other programs read a Value Change Dump of virtual boards: GTKWave, and sigrok, which is what PulseView reads with.

    cfmmr posture --on virtual --stop-after 0.3 --vcd waves.vcd
    crates/virtual-board/oracle/check_vcd.py waves.vcd

GTKWave's converter must keep every change of every signal. sigrok's CAN decoder, which sees nothing but the level of
the bus, must find the frames that the dump names, and nothing to complain about. Needs Debian's packages gtkwave and
sigrok-cli.
"""

import argparse
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

# Samples of the bus that sigrok is given, of the dump's nanoseconds: 10 a bit.
DOWNSAMPLE = 100


def run(*command):
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"check_vcd.py: {command[0]} failed: {done.stderr.strip()[-400:]}")
    return done.stdout + done.stderr


def changes(text):
    """Changes after the first time, by scope and name, each as (time, value)."""
    names, scope, found, time = {}, [], {}, 0
    for line in text.splitlines():
        word = line.split()
        if line.startswith("$scope"):
            scope.append(word[2])
        elif line.startswith("$upscope"):
            scope.pop()
        elif line.startswith("$var"):
            names[word[3]] = ".".join([*scope, word[4]])
        elif line.startswith("#"):
            time = int(line[1:])
        elif time and line and line[0] in "01xz":
            found.setdefault(names[line[1:]], []).append((time, line[0]))
        elif time and line.startswith("s"):
            found.setdefault(names[word[1]], []).append((time, word[0][1:]))
    return found


def gtkwave(file, own):
    with tempfile.TemporaryDirectory() as folder:
        converted = str(pathlib.Path(folder, "waves.fst"))
        run("vcd2fst", str(file), converted)
        theirs = changes(run("fst2vcd", converted))
    if theirs != own:
        differs = sorted(name for name in own if own[name] != theirs.get(name))
        sys.exit(f"check_vcd.py: GTKWave reads otherwise: {', '.join(differs)}")
    return sum(len(of) for of in own.values())


def sigrok(file, frames):
    """Frames that sigrok's decoder finds in the level of the bus."""
    said = run(
        *("sigrok-cli", "-i", str(file), "-I", f"vcd:downsample={DOWNSAMPLE}"),
        *("-P", "can:can_rx=level:nominal_bitrate=1000000", "-A", "can=id:full-id:dlc:data:warnings"),
    )
    found = []
    for line in said.splitlines():
        name, _, text = line.removeprefix("can-1: ").partition(": ")
        if match := re.fullmatch(r"Identifier", name):
            found.append([int(re.search(r"0x([0-9a-f]+)", text)[1], 16), ""])
        elif re.fullmatch(r"Data byte \d+", name):
            found[-1][1] += re.search(r"0x([0-9a-f]+)", text)[1].zfill(2)
        elif line.startswith("can-1") and "length" not in name:
            sys.exit(f"check_vcd.py: sigrok: {line}")
    theirs = [f"{id:03x}#{data}" for id, data in found]
    # One that the dump's end cut off.
    if theirs != frames[: len(theirs)] or len(theirs) < len(frames) - 1:
        sys.exit(f"check_vcd.py: sigrok found {len(theirs)} frames, the dump names {len(frames)}")
    return len(theirs)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("file", type=pathlib.Path, metavar="FILE", help="Value Change Dump of `cfmmr posture --on virtual`")
    arguments = parser.parse_args()
    for tool, package in [("vcd2fst", "gtkwave"), ("sigrok-cli", "sigrok-cli")]:
        if not shutil.which(tool):
            sys.exit(f"check_vcd.py: {tool} is missing: apt-get install {package}")
    own = changes(arguments.file.read_text())
    frames = [text for _, text in own["bus.frame"] if "#" in text]
    kept = gtkwave(arguments.file, own)
    print(f"{kept} changes kept by GTKWave; {sigrok(arguments.file, frames)} frames found by sigrok's CAN decoder")


if __name__ == "__main__":
    main()
