#!/usr/bin/env python3
"""Counts the instructions of the boards' algorithms on the virtual board's core.

Builds firmware-bench, runs it, prints the table, and fails if a mean count, a stack or a
code size is more than 2 % above tools/bench/counts.json. With --bless that file is rewritten;
`tools/scripts/regenerate.py instructions` then rewrites the page. With --cycles a table of cycles is printed.
"""

import argparse
import json
import pathlib
import subprocess
import sys

from elf_code import Image

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "crates/virtual-board/oracle"))
import core_side

TARGET = "thumbv7em-none-eabihf"
IMAGE = ROOT / "target" / TARGET / "image" / "firmware-bench"
COUNTS = ROOT / "tools/bench/counts.json"
TOLERANCE = 0.02
# Indices of a measurement: mean and largest count, bytes of stack, bytes of code.
MEAN, MOST, STACK, CODE = range(4)
# Differences of a few words of stack or instructions of code are no regression.
SLACK = {MEAN: 0, STACK: 16, CODE: 16}
# The printing of failed assertions is not part of an algorithm.
FAILURES = ("panic", "core3fmt", "semihosting")

# Title of each measurement, and its goal for the mean; None without a goal.
TITLES = {
    "sin_cos": ("sine and cosine together", 45),
    "sqrt": ("square root", 8),
    "tanh": ("hyperbolic tangent", 25),
    "atan2": ("arc tangent of two arguments", 35),
    "axle_filter_predict_update": ("axle filter, predict and update, 4 measurements", 700),
    "rps_piecewise_100": ("relative posture, piecewise, 100 segments, with covariance", None),
    "rps_quadrature": ("relative posture, quadrature, with covariance", None),
    "rps_elastica": ("relative posture, elastica fit, with covariance", None),
    "rps_elastica_contradiction": ("the same of readings no strip can give", None),
    "covariance_intersection": ("covariance intersection, 3×3", None),
    "covariance_intersection_trace": ("covariance intersection of least trace", None),
    "covariance_intersection_slender": ("covariance intersection, correlation 0.999", None),
    "joint_predict": ("joint filter, prediction by the odometry of both axles, 26 states", None),
    "joint_update": ("joint filter, update by the beam", None),
    "dynamic_controller": ("dynamic controller", 250),
    "kinematic_governor_cascade": ("kinematic controller, governor and cascade", 650),
    "train_3_begin": ("train of three axles, first step: curve through the axles", None),
    "train_3_plan": ("train of three axles, step that plans", None),
    "train_3_drive": ("train of three axles, step that drives", None),
    "train_3_ahead": ("train of three axles, planner in a tick", None),
    "train_5_begin": ("train of five axles, first step: curve through the axles", None),
    "train_5_plan": ("train of five axles, step that plans", None),
    "train_5_drive": ("train of five axles, step that drives", None),
    "train_5_ahead": ("train of five axles, planner in a tick", None),
    "tick_front": ("front board, plain tick", 1800),
    "tick_front_epoch": ("front board, tick that begins an epoch", None),
    "tick_front_lead": ("front board, tick with the lead node, at rest", None),
    "tick_rear": ("rear board, plain tick", 1800),
    "tick_rear_epoch": ("rear board, tick that begins an epoch", None),
    "tick_beam": ("beam board, plain tick", None),
    "tick_beam_epoch": ("beam board, tick that begins an epoch", None),
}

# Measured once; the libraries are not dependencies of this project.
OTHER_LIBRARIES = """\
| | mean | times ours | stack | code |
|---|---|---|---|---|
| axle filter of this project, 2026-11 | 597 | 1.0 | 228 | 17786 |
| nalgebra 0.35, equations of a textbook | 6305 | 10.6 | 1780 | 11988 |
| adskalman 0.18 | 7219 | 12.1 | 2284 | 13556 |
| kfilter 0.5 | 7111 | 11.9 | 1700 | 10630 |
| minikalman 0.8 | 10076 | 16.9 | 376 | 14586 |"""


def fail(text):
    sys.exit(f"count_instructions.py: {text}")


def run(what):
    """Builds the image and runs it on the core; returns its output. `what`: instructions or cycles."""
    build = ["cargo", "build", "--locked", "--quiet", "--package", "firmware-bench"]
    build += ["--profile", "image", "--target", TARGET]
    if subprocess.run(build, cwd=ROOT).returncode != 0:
        fail("the image does not build")
    command = [core_side.build("count"), IMAGE, what]
    try:
        ended = subprocess.run(command, capture_output=True, text=True, timeout=300)
    except subprocess.TimeoutExpired:
        fail("the image did not end within 5 minutes")
    if ended.returncode != 0:
        fail(f"the core ended with {ended.returncode}:\n{ended.stdout}{ended.stderr}")
    return ended.stdout


def print_cycles():
    """Prints a table of the cycles of each case."""
    means = []
    for what in ("instructions", "cycles"):
        lines = [line.split() for line in run(what).splitlines()]
        means.append({words[1]: int(words[2]) for words in lines if words[0] == "count"})
    print("| | instructions | cycles | cycles an instruction |\n|---|---|---|---|")
    for name, (title, _) in TITLES.items():
        count, took = (mean[name] for mean in means)
        print(f"| {title} | {count} | {took} | {took / count:.2f} |")


def measure():
    """Name -> [mean, largest, stack, code] of every measurement."""
    printed = run("instructions")
    counts, image, empty = {}, Image(IMAGE), 0
    for line in printed.splitlines():
        kind, *words = line.split()
        if kind == "calibration" and words != ["100", "1000"]:
            fail(f"100 and 1000 instructions were counted as {' and '.join(words)}")
        elif kind == "empty":
            empty = image.size(int(words[0], 16), FAILURES)
        elif kind == "count":
            name, *numbers, code = words
            size = image.size(int(code, 16), FAILURES) - empty
            counts[name] = [*map(int, numbers), size]
    missing = TITLES.keys() ^ counts.keys()
    if missing:
        fail(f"measured and described are not the same: {', '.join(sorted(missing))}")
    return counts


def page(counts):
    """Text of the page in the docs."""
    rows = ["| | mean | largest | goal | stack | code |", "|---|---|---|---|---|---|"]
    for name, (title, goal) in TITLES.items():
        mean, most, stack, code = counts[name]
        rows.append(f"| {title} | {mean} | {most} | {goal or ''} | {stack} | {code} |")
    missed = sum(1 for name, (_, goal) in TITLES.items() if goal and counts[name][0] > goal)
    return "\n".join(
        [
            "# Instructions on the board",
            "",
            "Counted by `tools/scripts/count_instructions.py` on the core of the virtual board, where",
            "every instruction takes the same simulated time; exact and the same in every run. *Mean* and *largest*",
            "are over several calls with different arguments; the call instruction counts. Elementary functions",
            "are inlined, so the cost of an empty function with the same arguments is subtracted. Instructions are",
            "not cycles: divisions, square roots and loads take more than one.",
            "",
            "*Stack*: bytes that a call writes below its caller's stack pointer, largest of the calls.",
            "*Code*: bytes of the calling function and of all functions that it calls, each once, with constants.",
            "Stack and code of an empty call are subtracted. The ticks of all three roles are one function, so",
            "their code is that of all nodes.",
            "",
            *rows,
            "",
            f"Of the goals {missed} are missed.",
            "",
            "## Other libraries",
            "",
            "Measured 2026-11 in one image with Rust 1.95. All filters have seven states and four",
            "measurements, and run predict and update for 100 steps. All use one motion model and one",
            "Jacobian, whose cost is included, and end at the same state to 1e-6. Each library was called by",
            "the cheapest interface that it offers. Only this project's filter keeps each posture",
            "component as the sum of two `f32` and the covariance as U D Uᵀ.",
            "",
            OTHER_LIBRARIES,
            "",
        ]
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bless", action="store_true", help="rewrite the committed counts")
    parser.add_argument("--page", action="store_true", help="print the page of the committed counts")
    parser.add_argument("--cycles", action="store_true", help="print a table of cycles")
    arguments = parser.parse_args()
    if arguments.cycles:
        print_cycles()
        return
    if arguments.page:
        print(page(json.loads(COUNTS.read_text())), end="")
        return
    counts = measure()
    if arguments.bless:
        COUNTS.write_text(json.dumps(counts, indent=2) + "\n")
        return
    committed = json.loads(COUNTS.read_text())
    worse = []
    for name, (title, _) in TITLES.items():
        before, now = committed.get(name, [0] * 4), counts[name]
        print(f"{title:64} {now[MEAN]:6} {now[MEAN] - before[MEAN]:+6}")
        for kind, slack in SLACK.items():
            if now[kind] > before[kind] * (1 + TOLERANCE) + slack:
                what = {MEAN: "", STACK: " (stack)", CODE: " (code)"}[kind]
                worse.append(f"{title}{what}: {now[kind]}, was {before[kind]}")
    if worse:
        fail("more than 2 % worse:\n" + "\n".join(worse) + "\nif that is right: --bless, then tools/scripts/regenerate.py instructions")


if __name__ == "__main__":
    main()
