#!/usr/bin/env python3
"""Effect of a late, lossy or damaged bus on the drive to the origin: prints the table of docs/bus.md.

    tools/scripts/bus_table.py CFMMR [--trials N] [--only TEXT]

A row is one bus, for robots with and without an IMU. Exit code 1 if a robot reports *reached* outside its tolerance.
"""
import argparse
import csv
import math
import statistics
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

TOLERANCE_M, TOLERANCE_RAD = 0.1, math.radians(5)
BOARDS = ("front", "rear", "beam")
# Notices that also occur in single drives with a sound bus.
USUAL = {"measurement refused"}


def late(board, ms):
    return f"late_ms={[ms * (board == each) for each in BOARDS]}"


def rows():
    """Name and settings of each bus."""
    for ms in (0, 4, 8, 20, 30, 40, 60, 100):
        yield f"{ms} ms late", [f"latency_ms={ms}"]
    for board in BOARDS:
        for ms in (8, 20, 40, 100):
            yield f"{board} board {ms} ms later", [late(board, ms)]
    for ms in (4, 8, 20, 50, 100):
        yield f"each frame up to {ms} ms later", [f"jitter_ms={ms}"]
    for share in (0.01, 0.05, 0.1, 0.2):
        yield f"{100 * share:.0f} % lost", [f"loss={share}"]
    for share in (0.3, 1):
        yield f"{100 * share:.0f} % doubled", [f"doubling={share}"]
    for share in (0.001, 0.01, 0.05):
        yield f"{100 * share:g} % damaged unnoticed", [f"corruption={share}"]
    for name, settings in [
        ("8 ms late, 5 % lost", ["latency_ms=8", "loss=0.05"]),
        ("20 ms late, each up to 8 ms later", ["latency_ms=20", "jitter_ms=8"]),
        ("20 ms late, 5 % lost", ["latency_ms=20", "loss=0.05"]),
        ("each up to 8 ms later, 5 % lost", ["jitter_ms=8", "loss=0.05"]),
        ("each up to 8 ms later, 30 % doubled", ["jitter_ms=8", "doubling=0.3"]),
        ("each up to 20 ms later, 10 % lost", ["jitter_ms=20", "loss=0.1"]),
        ("30 % doubled, 5 % lost", ["doubling=0.3", "loss=0.05"]),
        ("beam board 20 ms later, 5 % lost", [late("beam", 20), "loss=0.05"]),
        ("front and rear board 8 ms later", ["late_ms=[8, 8, 0]"]),
        ("front and beam board 20 ms later", ["late_ms=[20, 0, 20]"]),
        ("rear and beam board 20 ms later", ["late_ms=[0, 20, 20]"]),
    ]:
        yield name, settings


def drive(program, settings, trials, folder):
    """Runs the trials; returns the rows of trials.csv."""
    command = [program, "posture", "--rows", "joint", "--trials", str(trials), "--seed", "7071", "--out", str(folder)]
    for setting in settings:
        command += ["--set", f"bus.{setting}"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode not in (0, 1):
        sys.exit(f"{' '.join(command)}: {done.stderr.strip()}")
    with open(folder / "trials.csv") as file:
        return list(csv.DictReader(file))


def falsely(trial):
    off = float(trial["e_m"]) > TOLERANCE_M or abs(float(trial["heading_rad"])) > TOLERANCE_RAD
    return trial["end"] == "reached" and off


def counted(names):
    return ", ".join(f"{name} {count}" for name, count in Counter(names).most_common())


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", metavar="CFMMR")
    parser.add_argument("--trials", type=int, default=40)
    parser.add_argument("--only", default="", metavar="TEXT", help="rows whose name contains this text")
    args = parser.parse_args()
    print("| bus | beam postures used | notices | ends | e (cm) | falsely reached |")
    print("|---|---|---|---|---|---|")
    wrong = 0
    with tempfile.TemporaryDirectory() as folder:
        for name, settings in rows():
            if args.only not in name:
                continue
            trials = drive(args.program, settings, args.trials, Path(folder))
            used = statistics.median(float(trial["beam_share"]) for trial in trials)
            notices = [one for trial in trials for one in trial["notices"].split("; ") if one and one not in USUAL]
            arrived = [float(trial["e_m"]) for trial in trials if trial["end"] in ("reached", "uncertain")]
            error = f"{100 * statistics.mean(arrived):.1f}" if arrived else ""
            false = sum(map(falsely, trials))
            wrong += false
            ends = counted(trial["end"] for trial in trials)
            print(f"| {name} | {100 * used:.0f} % | {counted(notices)} | {ends} | {error} | {false} |", flush=True)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
