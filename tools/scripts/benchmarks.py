#!/usr/bin/env python3
"""Prints the speeds on this machine for docs/benchmarks.md.

Plant alone and MuJoCo in one run, and scaling of Monte Carlo runs of the whole closed loop with threads and
memory. One command on an idle machine, about five minutes:

    pip install mujoco && cargo build --release && tools/scripts/regenerate.py benchmarks

`--quick` tests the script in a minute; its figures are not usable. The page links to
docs/profile.md, which is written by hand and describes the time of each part of the loop.
"""

import argparse
import concurrent.futures
import datetime
import json
import os
import pathlib
import platform
import statistics
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
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


def drives(repeats):
    """Real-time factors of the plant alone by drive, one per run."""
    factors = {}
    for _ in range(repeats):
        command = "cargo run --release --quiet --locked --package plant --example drives"
        for line in output(*command.split()).splitlines():
            name, factor = line.rsplit(": ", 1)
            factors.setdefault(name, []).append(float(factor))
    return factors


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
    parser.add_argument("--quick", action="store_true", help="few repeats, for a trial of the script")
    arguments = parser.parse_args()
    if not BINARY.exists():
        fail(f"{BINARY} is not there; cargo build --release makes it")
    if arguments.trials < 20:
        parser.error(f"--trials {arguments.trials}: must be at least 20")
    if arguments.quick:
        arguments.trials = 20

    try:
        rounds = ["--repeats", "2"] if arguments.quick else []
        beside = json.loads(output(sys.executable, "tools/scripts/bench_mujoco.py", "--json", *rounds))
    except subprocess.CalledProcessError as error:
        fail(error.stderr.strip())
    plant = drives(3 if arguments.quick else 15)

    few, many = arguments.trials // 10, arguments.trials
    rows, results = [], {}
    for threads in (1, 2):
        start, end = monte_carlo(few, threads), monte_carlo(many, threads)
        # Time that does not depend on the number of trials (pictures, files) cancels.
        rate = (many - few) / (end[0] - start[0])
        rows.append((threads, rate, start[2], end[2]))
        results[threads] = end[3]
    same = "the same bytes" if results[1] == results[2] else "DIFFERENT RESULTS"
    gain = rows[1][1] / rows[0][1]
    # Reference for the gain: two independent programs in parallel.
    with concurrent.futures.ThreadPoolExecutor(2) as pool:
        both = [list(pool.map(monte_carlo, [n, n], [1, 1])) for n in (few, many)]
    start, end = (max(run[0] for run in runs) for runs in both)
    ceiling = 2 * (many - few) / (end - start) / rows[0][1]

    page = [
        f"- {datetime.date.today()}, {processor()}, {os.cpu_count()} cores, {platform.system()} {platform.release()}",
        f"- {output('rustc', '--version').strip()}, release profile; MuJoCo {beside['mujoco']},"
        f" Python {platform.python_version()}",
        "- real-time factors on one core: median (slowest to fastest)",
        "",
        "## Plant alone, 1 ms steps",
        "",
        "| drive | cfmmr | cfmmr and MuJoCo by turns | |",
        "|---|---|---|---|",
    ]
    for name, factors in plant.items():
        span = f"{statistics.median(factors):.0f} ({min(factors):.0f} to {max(factors):.0f})"
        turns = {r["model"]: r for r in beside["drives"] if r["name"] == name}
        own = turns.pop("cfmmr")
        if not turns:
            page.append(f"| {name} | {span} | {own['real_time_factor']:.0f} | |")
        for model, row in turns.items():
            page.append(
                f"| {name} | {span} | {own['real_time_factor']:.0f} |"
                f" {model}: {row['real_time_factor']:.0f} |"
            )
    page += [
        "",
        "Where the time goes: [profile.md](profile.md).",
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
    page += ["", f"Two threads: {gain:.2f} times as fast as one, {same}. Two processes of one"
             f" thread each, at the same time: {ceiling:.2f} times as fast as one."]
    print("\n".join(page))


if __name__ == "__main__":
    main()
