#!/usr/bin/env python3
"""Prints root mean square errors before and after the calibration of several simulated robots.

    tools/scripts/calibration_errors.py wheels [--seeds 6] [OPTION...]     options of `cfmmr calibrate`

The mean is over all robots, boards and gauges with the parameter.
"""

import argparse
import json
import math
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "target" / "release" / "cfmmr"


def digits(value):
    """Value with two significant digits, or as a whole number."""
    return f"{value:.{max(0, 1 - math.floor(math.log10(max(abs(value), 1e-9))))}f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=["wheels", "gauges", "imu"])
    parser.add_argument("--seeds", type=int, default=6, help="number of robots")
    arguments, options = parser.parse_known_args()
    errors, failed, world = {}, [], ""
    for seed in range(1, arguments.seeds + 1):
        with tempfile.TemporaryDirectory() as flash:
            words = [PROGRAM, "calibrate", arguments.what, "--seed", str(seed), "--flash", flash, "--json", "-"]
            run = subprocess.run([*words, *options], capture_output=True, text=True, stdin=subprocess.DEVNULL)
        if run.returncode == 2:
            sys.exit(run.stderr)
        if run.returncode != 0:
            failed.append(f" Seed {seed}: {run.stderr.strip().splitlines()[-1]}.")
            continue
        report = json.loads(run.stdout)
        world = report["world"]
        for row in report["parameters"]:
            pair = (row["before"] - row["truth"], row["after"] - row["truth"])
            errors.setdefault((f"`{row['name'].split('[')[0]}`", row["unit"]), []).append(pair)
        for row in report["effects"]:
            errors.setdefault((row["what"], row["unit"]), []).append((row["before"], row["after"]))
    print("| rms | unit | before | after |\n|---|---|---|---|")
    for (what, unit), pairs in errors.items():
        before, after = (digits(math.sqrt(sum(x * x for x in column) / len(pairs))) for column in zip(*pairs))
        print(f"| {what} | {unit} | {before} | {after} |")
    print(f"\n{arguments.seeds - len(failed)} of {arguments.seeds} robots, world {world}.{''.join(failed)}")


if __name__ == "__main__":
    main()
