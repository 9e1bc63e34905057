#!/usr/bin/env python3
"""Speeds on this machine, as one page: docs/benchmarks.md.

Plant alone beside MuJoCo in the same run, the whole closed loop, and how Monte Carlo runs scale
with threads and memory. Takes about four minutes; let nothing else run meanwhile.

Needs: pip install mujoco; cargo build --release
"""

import argparse
import json
import os
import pathlib
import platform
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parent.parent
BINARY = ROOT / "target" / "release" / "cfmmr"


def fail(text):
    sys.exit(f"benchmarks.py: {text}")


def output(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout


def processor():
    for line in pathlib.Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor() or "unknown"


def bench(name, *extra):
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "bench.json"
        subprocess.run([BINARY, name, "--json", path, *extra], check=True, stdout=subprocess.DEVNULL)
        return json.loads(path.read_text())


def monte_carlo(trials, threads):
    """Wall time (s), processor time (s) and largest memory (MB) of a paired experiment."""
    with tempfile.TemporaryDirectory() as folder:
        command = [BINARY, "posture", "--rows", "pair", "--trials", str(trials)]
        started = time.monotonic()
        child = subprocess.Popen(
            [*command, "--threads", str(threads), "--out", folder], stdout=subprocess.DEVNULL
        )
        _, status, usage = os.wait4(child.pid, 0)
        taken = time.monotonic() - started
        if status != 0:
            fail(f"{' '.join(map(str, command))} failed")
        result = (pathlib.Path(folder) / "result.json").read_bytes()
    return taken, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, result


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=200, help="trials of the Monte Carlo runs")
    parser.add_argument("--print", action="store_true", help="print the page, do not write it")
    arguments = parser.parse_args()
    if not BINARY.exists():
        fail(f"{BINARY} is not there; cargo build --release makes it")
    if arguments.trials < 20:
        parser.error(f"--trials {arguments.trials}: must be at least 20")

    try:
        beside = json.loads(output(sys.executable, "scripts/bench_mujoco.py", "--json"))
    except subprocess.CalledProcessError as error:
        fail(error.stderr.strip())
    plant, loop = bench("plant-bench", "--repeats", "15"), bench("loop-bench", "--repeats", "15")

    few, many = arguments.trials // 10, arguments.trials
    rows, results = [], {}
    for threads in (1, 2):
        start, end = monte_carlo(few, threads), monte_carlo(many, threads)
        # What does not depend on the number of trials (pictures, files) cancels.
        rate = (many - few) / (end[0] - start[0])
        rows.append((threads, rate, start[2], end[2]))
        results[threads] = end[3]
    same = "the same bytes" if results[1] == results[2] else "DIFFERENT RESULTS"
    gain = rows[1][1] / rows[0][1]

    page = [
        "# Speed on a computer",
        "",
        "Written by `scripts/benchmarks.py`. Instructions on the boards' processor, beside four other",
        "filter libraries, stand in [instructions.md](instructions.md).",
        "",
        f"- {processor()}, {os.cpu_count()} cores, {platform.system()} {platform.release()}",
        f"- {output('rustc', '--version').strip()}, release profile; MuJoCo {beside['mujoco']},"
        f" Python {platform.python_version()}",
        f"- real-time factors in {plant['clock']} time of one core: median (slowest to fastest)",
        "",
        "## Plant alone, 1 ms steps",
        "",
        "| drive | cfmmr | cfmmr and MuJoCo by turns | |",
        "|---|---|---|---|",
    ]
    span = "{real_time_factor:.0f} ({slowest:.0f} to {fastest:.0f})"
    for drive in plant["drives"]:
        turns = {r["model"]: r for r in beside["drives"] if r["name"] == drive["name"]}
        own = turns.pop("cfmmr")
        for model, row in turns.items():
            page.append(
                f"| {drive['name']} | {span.format(**drive)} | {own['real_time_factor']:.0f} |"
                f" {model}: {row['real_time_factor']:.0f} |"
            )
    page += [
        "",
        "## Whole closed loop",
        "",
        "Plant, sensors, the nodes of three boards at 1 kHz and the bus, one core.",
        "",
        "| | real-time factor |",
        "|---|---|",
    ]
    names = {"plain": "without a log", "logged": "with a log of every epoch as CSV"}
    page += [f"| {names[row['name']]} | {span.format(**row)} |" for row in loop["loops"]]
    page += [
        "",
        "## Monte Carlo",
        "",
        f"`cfmmr posture --rows pair`, {few} and {many} trials of each of two rows; pairs a second"
        f" from the difference, memory at {few} and at {many}.",
        "",
        "| threads | pairs a second | memory (MB) |",
        "|---|---|---|",
    ]
    page += [f"| {n} | {rate:.2f} | {a:.0f}, {b:.0f} |" for n, rate, a, b in rows]
    page += ["", f"Two threads: {gain:.2f} times as fast as one, {same}.", ""]
    text = "\n".join(page)
    if arguments.print:
        print(text)
        return
    path = ROOT / "docs" / "benchmarks.md"
    temporary = path.with_suffix(".tmp")
    temporary.write_text(text)
    temporary.replace(path)
    print(f"wrote {path.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
