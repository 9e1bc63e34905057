#!/usr/bin/env python3
"""Attacks `cfmmr` from outside: damaged files, wrong options, names and environments, bad peers, full disks, signals.

    tools/attack/attack.py CFMMR [--seed N] [--times X] [--only KIND[:INDEX]] [--keep DIR]

Prints a table of all kinds and a line for each defect. A case is drawn from the seed, its kind and its index.

refused: runs with an exit code other than 0. silent acceptances: exit code 0 after wrong input, or a result that
differs from that of sound input. half-written files: incomplete results, temporary files, and files of refused runs.
wrong exit codes: also messages that do not name the cause.

Exit code 0: no defect; 1: defects; 2: wrong usage.
"""
import argparse
import shlex
import shutil
import sys
import tempfile
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cases_ends
import cases_files
import cases_keys
import cases_logs
import cases_messages
import cases_names
import cases_options
import cases_run
import cases_serial
import cases_text
from bench import COLUMNS, Bench, Unsound, snapshot

KINDS = [
    cases_logs.Logs, cases_logs.Blocks, cases_text.Toml, cases_text.Lines, cases_options.Options, cases_options.Inputs,
    cases_messages.Messages,
    cases_keys.Constants, cases_keys.Spreads, cases_keys.Pairs, cases_keys.Whole, cases_keys.Misspelled,
    cases_names.Names, cases_names.Angles, cases_names.Outputs, cases_names.Controls,
    cases_files.Sizes, cases_files.Recover, cases_files.Separators, cases_ends.Terminals, cases_ends.Full, cases_ends.Shards,
    cases_serial.Serial, cases_run.Disk, cases_run.Signals, cases_run.Live,
]

# Largest file that is kept of a case, bytes.
LARGEST_COPY = 64 << 20


class Attack:
    """All cases of the chosen kinds."""

    def __init__(self, args, folder):
        self.args, self.folder = args, folder
        self.bench = Bench(str(Path(args.program).resolve()), args.seed)
        self.rows, self.defects, self.notes = [], [], []

    def one(self, kind, index):
        """Runs a case; returns exit code and defects."""
        folder = self.folder / f"{kind.name}-{index}"
        folder.mkdir()
        case = kind.case(self.bench.rng(kind.name, index), index, folder)
        before = snapshot(folder)
        ended = self.bench.run(case, folder)
        found = self.bench.judge(case, ended, folder, before)
        if found:
            self.keep(folder, case, ended, found)
        shutil.rmtree(folder)
        return index, case, ended, found

    def keep(self, folder, case, ended, found):
        """Copies a case with its outputs."""
        kept = self.args.keep / folder.name
        shutil.rmtree(kept, ignore_errors=True)
        special = lambda place, names: [name for name in names if not is_copied(Path(place, name))]
        shutil.copytree(folder, kept, symlinks=True, ignore=special)
        (kept / "attack.out").write_bytes(ended.out)
        (kept / "attack.err").write_text(ended.err)
        if isinstance(case.stdin, bytes):
            (kept / "attack.in").write_bytes(case.stdin)
        lines = [shell(case), f"exit code {ended.code}", *(f"{column}: {text}" for column, text in found)]
        (kept / "attack.txt").write_text("\n".join(lines) + "\n", errors="backslashreplace")

    def kind(self, make, only_index):
        folder = self.folder / f"{make.name}-sound"
        folder.mkdir()
        kind = make(self.bench, folder)
        try:
            reason = kind.prepare()
        except Unsound as error:
            reason = str(error)
            self.defects.append(f"- {kind.name}: a sound command failed: {reason}")
        if reason:
            self.notes.append(f"{kind.name}: not attacked: {reason}")
        indices = [] if reason else range(kind.total(self.args.times)) if only_index is None else [only_index]
        counts, runs = Counter(), Counter()
        with ThreadPoolExecutor(kind.parallel) as pool:
            for index, case, ended, found in pool.map(lambda index: self.one(kind, index), indices):
                runs["runs"] += 1
                if not ended.hung and not ended.panicked:
                    runs["accepted" if ended.code == 0 else "refused"] += 1
                for column in {column for column, _ in found}:
                    counts[column] += 1
                for column, text in found:
                    name = f"{kind.name}:{index} `{shell(case)}`"
                    self.defects.append(f"- {name}: exit code {ended.code}: {column}: {text}")
        ends = [runs[key] for key in ("runs", "refused", "accepted")]
        self.rows.append([kind.name, *ends, *(counts[column] for column in COLUMNS)])

    def report(self):
        head = ["kind", "runs", "refused", "accepted", *COLUMNS]
        for row in [head, ["---"] * len(head), *self.rows]:
            print(f"| {' | '.join(map(str, row))} |")
        if self.notes or self.defects:
            print()
        for line in self.notes + self.defects:
            print(line.encode(errors="backslashreplace").decode())
        if self.defects:
            print(f"\nCases: {self.args.keep}/KIND-INDEX, command in attack.txt, output in attack.out and attack.err.")


def is_copied(path):
    """True for folders and for files of at most LARGEST_COPY bytes; a copy of a sparse file is not sparse."""
    return path.is_dir() or path.is_file() and path.stat().st_size <= LARGEST_COPY


def shell(case):
    """Command line of a case, long arguments cut."""
    words = (word.decode(errors="surrogateescape") if isinstance(word, bytes) else str(word) for word in case.words)
    words = (word if len(word) <= 200 else f"{word[:40]}...({len(word)} characters)" for word in words)
    text = " ".join(shlex.quote(word) for word in ["cfmmr", *words]).replace("\n", "\\n")
    return text + {bytes: " < attack.in", type(None): ""}.get(type(case.stdin), f" < {case.stdin}")


def arguments():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", metavar="CFMMR")
    parser.add_argument("--seed", type=int, default=1)
    names = [kind.name for kind in KINDS]
    parser.add_argument("--times", type=float, default=1.0, help="number of cases relative to the short form")
    parser.add_argument("--only", metavar="KIND[:INDEX]", help=", ".join(names))
    parser.add_argument(
        "--keep", type=Path, default=Path("target/attack"), metavar="DIR", help="folder of the cases with defects"
    )
    args = parser.parse_args()
    if not Path(args.program).is_file():
        parser.error(f"{args.program}: must be the program")
    if not 0 < args.times <= 1e6:
        parser.error(f"--times {args.times}: must be above 0, at most 1e6")
    args.name, _, index = (args.only or "").partition(":")
    args.index = int(index) if index.isdigit() else None
    if args.only is not None and (args.name not in names or index and args.index is None):
        parser.error(f"--only {args.only}: must be KIND or KIND:INDEX, KIND one of {', '.join(names)}")
    args.keep = args.keep.resolve()
    return args


def main():
    args = arguments()
    with tempfile.TemporaryDirectory(prefix="attack-") as folder:
        attack = Attack(args, Path(folder))
        for kind in KINDS:
            if args.name in ("", kind.name):
                attack.kind(kind, args.index)
        attack.report()
    sys.exit(1 if attack.defects else 0)


if __name__ == "__main__":
    main()
