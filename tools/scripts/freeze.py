#!/usr/bin/env python3
"""Prints hashes of the raw results, to show that a change of the program changes no result.

    freeze.py --quick [--detail]    two minutes; 5 trials, a campaign of 16 runs, 2 s on boards
    freeze.py --full [--detail]     half an hour; 20 trials, a campaign of 64 runs, whole runs, fault tables
    freeze.py --quick --check FILE  also compare with the lines in FILE; exit 1 on a difference
    freeze.py --quick --renamed NAMES [--program FILE]
                                    compare two versions whose columns have other names

Each line holds a name, the number of values and the SHA-256 of the values. Numbers are hashed as IEEE 754 doubles, other
values as text, so the printed form of a number does not count. --detail prints a line for each column, key and topic.
Builds the program first, unless --program names one. NAMES is a JSON object of old and new names of columns; a table
with such columns is compared in these columns only. Installs the Python package mcap in target/python.
"""

import argparse
import csv
import hashlib
import json
import os
import struct
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = ROOT / "target/release/cfmmr"
WORLDS = ["careful", "ordinary", "ideal", "paper"]
STUDY = """name = "freeze"
seed = 1
trials = {trials}
block = 4
starts = "random"
[[vary]]
key = "mission.rps"
values = [true, false]
[[vary]]
key = "sensors.placement.heading_sigma_rad"
values = [0.0, 0.01]
"""


def to_bytes(value):
    """Bytes of a value: a number as a double, anything else as text."""
    if isinstance(value, bool) or value is None:
        return repr(value).encode()
    try:
        return struct.pack("<d", float(value))
    except (TypeError, ValueError):
        return str(value).encode() + b"\0"


def leaves(value, path=""):
    """Pairs of path and value; entries of a list have the path of the list."""
    if isinstance(value, dict):
        for key in sorted(value):
            yield from leaves(value[key], f"{path}.{key}" if path else key)
    elif isinstance(value, list):
        for inner in value:
            yield from leaves(inner, path)
    else:
        yield path, value


class Report:
    """Prints a line for each result and keeps the lines."""

    def __init__(self, detail, renamed):
        self.detail, self.renamed, self.lines = detail, renamed, []

    def add(self, name, pairs):
        columns = defaultdict(list)
        for column, value in pairs:
            columns[self.renamed.get(column, column)].append(to_bytes(value))
        known = columns.keys() & set(self.renamed.values())
        if known:
            columns = {column: columns[column] for column in known}
        hashes = {column: hashlib.sha256(b"".join(parts)) for column, parts in columns.items()}
        if self.detail:
            for column in sorted(columns):
                self.line(f"{name} {column}", len(columns[column]), hashes[column])
        total = hashlib.sha256()
        for column in sorted(columns):
            total.update(column.encode() + hashes[column].digest())
        self.line(name, sum(map(len, columns.values())), total)

    def line(self, name, count, value):
        self.lines.append(f"{name:<40} {count:>8}  {value.hexdigest()[:16]}")
        print(self.lines[-1], flush=True)

    def table(self, name, path):
        with open(path, newline="") as file:
            rows = csv.DictReader(file)
            self.add(name, [pair for row in rows for pair in row.items()])

    def json(self, name, path, without=()):
        result = json.loads(Path(path).read_text())
        # Version, build and commit differ.
        result.pop("run", None)
        pairs = leaves(result)
        self.add(name, [(at, value) for at, value in pairs if at.split(".")[-1] not in without])

    def log(self, name, path):
        from mcap.reader import make_reader

        with open(path, "rb") as file:
            pairs = []
            for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
                pairs.append((channel.topic, message.log_time))
                if channel.message_encoding == "json":
                    content = json.loads(message.data)
                    pairs += [(channel.topic, value) for _, value in leaves(content)]
                else:
                    pairs.append((channel.topic, message.data.hex()))
        self.add(name, pairs)

program = PROGRAM


def run(*arguments):
    result = subprocess.run([program, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True)
    if result.returncode not in (0, 1):
        sys.exit(f"freeze.py: cfmmr {' '.join(map(str, arguments))}: exit {result.returncode}\n{result.stderr}")


def posture(report, out, trials):
    for world in WORLDS:
        run("posture", "--world", world, "--rows", "all", "--trials", trials, "--out", out / world, "--json", out / f"{world}.json")
        report.table(f"posture {world}, trials", out / world / "trials.csv")
        report.json(f"posture {world}, summary", out / f"{world}.json")


def logs(report, out):
    run("follow", "--imu", "--log", out / "run.mcap", "--csv", out / "csv", "--out", out / "follow")
    for table in ["epochs", "axles", "beam", "bus"]:
        report.table(f"follow, {table}.csv", out / "csv" / f"{table}.csv")
    report.log("follow, MCAP", out / "run.mcap")


def campaign(report, out, trials):
    study = out / "freeze.toml"
    study.write_text(STUDY.format(trials=trials))
    run("campaign", study, "--out", out / "campaign")
    run("campaign", "merge", out / "campaign", "--json", out / "campaign.json")
    report.json("campaign", out / "campaign.json")


def boards(report, out, *limits):
    run("hil", "--on", "virtual", *limits, "--out", out / "session", "--csv", out / "session-csv")
    report.table("boards in a session, epochs.csv", out / "session-csv/epochs.csv")
    run("posture", "--on", "virtual", *limits, "--out", out / "virtual", "--csv", out / "virtual-csv", "--threads", "1")
    report.table("virtual boards, epochs.csv", out / "virtual-csv/epochs.csv")


def faults(report, out):
    for name, options in [("in process", []), ("virtual", ["--on", "virtual", "--quick"])]:
        path = out / f"faults {name}.json"
        run("faults", *options, "--json", path)
        report.json(f"faults {name}", path)


def with_mcap():
    """Restarts this script with a Python that has the package mcap."""
    python = ROOT / "target/python/bin/python"
    if Path(sys.executable) != python:
        tools = "set -e; . tools/scripts/python_tools.sh; python_tools freeze.py"
        subprocess.run(["bash", "-c", tools], cwd=ROOT, check=True)
        os.execv(python, [python, *sys.argv])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    size = parser.add_mutually_exclusive_group(required=True)
    size.add_argument("--quick", action="store_true")
    size.add_argument("--full", action="store_true")
    parser.add_argument("--detail", action="store_true")
    parser.add_argument("--check", metavar="FILE", type=Path)
    parser.add_argument("--renamed", metavar="NAMES", type=Path)
    parser.add_argument("--program", metavar="FILE", type=Path, default=PROGRAM)
    arguments = parser.parse_args()
    with_mcap()
    if arguments.program == PROGRAM:
        build = ["cargo", "build", "--quiet", "--locked", "--release", "--package", "cfmmr", "--all-features"]
        subprocess.run(build, cwd=ROOT, check=True)
    global program
    program = arguments.program
    report = Report(arguments.detail, json.loads(arguments.renamed.read_text()) if arguments.renamed else {})
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        posture(report, out, 5 if arguments.quick else 20)
        logs(report, out)
        campaign(report, out, 4 if arguments.quick else 16)
        boards(report, out, *(["--stop-after", "2"] if arguments.quick else []))
        if arguments.full:
            faults(report, out)
    if arguments.check:
        # The order and the additional lines of a detailed file do not count.
        wanted = set(arguments.check.read_text().splitlines())
        changed = [line for line in report.lines if line not in wanted]
        if changed:
            sys.exit("freeze.py: not as in " + str(arguments.check) + ":\n" + "\n".join(changed))


if __name__ == "__main__":
    main()
