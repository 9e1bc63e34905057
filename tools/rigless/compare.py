#!/usr/bin/env python3
"""Compares counts of the default images on a virtual board and on the emulator rigless.

    tools/rigless/compare.py

Both boards run alone, for 0.4 s from the first tick of SysTick on: longer the emulator cannot, which has no
CAN controller, so that the images' watchdog resets it half a second after its start. Compared is what both
model: SysTick, the interrupts that the programs raise themselves (executors, CAN1 without a frame), and on
the beam the timer's scans, their conversions and the interrupts of the stream that fetches them. Each may
differ by one, as the first tick is no common point of all; conversions by those of one interrupt. Exit 1
beyond that.

It needs Rust 1.98.0 (rustup installs it when it is first used) and builds for some minutes.
"""

import json
import pathlib
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
TARGET = "thumbv7em-none-eabihf"
SECONDS = "0.4"
CHANNELS = 6
NAMES = {
    15: "SysTick",
    35: "CAN1 TX",
    36: "CAN1 RX0",
    68: "executor of the tick (UART4)",
    69: "executor of the bus (UART5)",
    72: "DMA2 stream 0",
}
# The axle's tick begins with an injected conversion, and it sends frames: neither is there.
COMPARED = {"firmware-axle": [15, 36, 69], "firmware-beam": list(NAMES)}


def run(command, **arguments):
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, **arguments)
    if done.returncode != 0:
        sys.exit(f"compare.py: {' '.join(map(str, command))} ended with {done.returncode}")
    return done.stdout


def theirs(image):
    # In its own directory, where its own toolchain is chosen.
    command = ["cargo", "run", "--locked", "--quiet", "--release"]
    command += ["--target-dir", ROOT / "target" / "rigless", "--", image, SECONDS]
    return json.loads(run(command, cwd=HERE))


def ours(image):
    command = ["cargo", "run", "--locked", "--quiet", "--release", "--package", "virtual-board"]
    return json.loads(run(command + ["--example", "counts", "--", image, SECONDS], cwd=ROOT))


def rows(name, other, own):
    """What, on rigless, on the virtual board, and by how much they may differ."""
    for number in COMPARED[name]:
        counts = [counts["exceptions"].get(str(number), 0) for counts in (other, own)]
        yield NAMES[number], *counts, 1
    if 72 in COMPARED[name]:
        interrupts = max(1, own["exceptions"]["72"])
        slack = own["conversions"] // interrupts
        yield "conversions of ADC1", CHANNELS * other["scans"], own["conversions"], slack
    yield "resets", other["resets"], own["resets"], 0


def main():
    wrong = 0
    print("| image | | rigless | virtual board | |\n|---|---|---|---|---|")
    for name in COMPARED:
        build = ["cargo", "build", "--locked", "--quiet", "--profile", "image", "--target", TARGET]
        run(build + ["--package", name], cwd=ROOT)
        image = ROOT / "target" / TARGET / "image" / name
        for what, other, own, slack in rows(name, theirs(image), ours(image)):
            differs = abs(other - own) > slack or (own == 0 and what != "resets")
            wrong += differs
            print(f"| {name} | {what} | {other} | {own} | {'differs' if differs else ''} |")
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
