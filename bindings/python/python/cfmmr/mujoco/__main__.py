"""Command line: python -m cfmmr.mujoco."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from pathlib import Path

from .._native import InputError, RunError, Scenario
from ..runs import refused
from . import media
from .grounds import KINDS, Ground
from .trials import COLUMNS, Row, Trial, cells, run_trial

SUCCESSES = ("reached", "uncertain")


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; gives its exit code."""
    options = parser().parse_args(arguments)
    try:
        return _run(options)
    except InputError as error:
        print(f"cfmmr.mujoco: {error}", file=sys.stderr)
        return 2
    except (RunError, media.MediaError) as error:
        print(f"cfmmr.mujoco: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        # The reader of the table has ended; Python would fail again at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        print("cfmmr.mujoco: interrupted", file=sys.stderr)
        return 130


def parser() -> argparse.ArgumentParser:
    command = argparse.ArgumentParser(
        prog="python -m cfmmr.mujoco",
        description="Drive the robot in MuJoCo, beside the plant of this project: the same boards, errors and seeds.",
    )
    command.add_argument("task", choices=["posture", "follow"], help="drive to the origin, or along a path")
    command.add_argument("--world", metavar="NAME|FILE", default="careful", help="world of the robot [careful]")
    command.add_argument(
        "--set", metavar="KEY=VALUE", action="append", default=[], help="change a key of the scenario; may be repeated"
    )
    command.add_argument("--axles", metavar="N", type=int, help="number of axles, 2 to 5 [2]")
    command.add_argument("--trials", metavar="N", type=int, default=10, help="trials a row [10]")
    command.add_argument("--seed", metavar="S", type=int, default=1, help="seed of all random draws [1]")
    command.add_argument(
        "--ground", metavar="GROUND", action="append", help=f"ground: {KINDS}; may be repeated [flat]"
    )
    command.add_argument(
        "--rows", metavar="ROWS", help="rows of `cfmmr posture`: main, pair, joint or all [gauges and the joint filter]"
    )
    command.add_argument("--imu", action="store_true", help="with gyroscopes and accelerometers")
    command.add_argument(
        "--path", metavar="PATH", default="sine",
        help="path to follow: sine (6 m long), line, circle, figure-eight or a CSV file of waypoints [sine]",
    )
    command.add_argument(
        "--impratio", metavar="RATIO", type=float, default=10.0,
        help="stiffness of friction over that of the normal force in MuJoCo's contacts [10]",
    )
    command.add_argument("--threads", metavar="N", type=int, default=os.cpu_count() or 1, help="processes [one a core]")
    command.add_argument("--out", metavar="DIR", type=Path, help="write trials.csv and pictures to this folder")
    command.add_argument("--gif", action="store_true", help="write a film of the first trial on each ground to --out")
    command.add_argument("--json", metavar="FILE", help="write the trials as JSON to FILE; with - to standard output")
    return command


def _run(options: argparse.Namespace) -> int:
    for name, least in (("trials", 1), ("seed", 0), ("threads", 1)):
        if getattr(options, name) < least:
            raise refused(f"--{name}", getattr(options, name), f"a whole number of at least {least}")
    if not 0.1 <= options.impratio <= 1000:
        raise refused("--impratio", options.impratio, "a number from 0.1 to 1000")
    if options.gif and options.out is None:
        raise refused("--gif", "without --out", "with --out DIR")
    if options.task == "posture" and options.path != "sine":
        raise refused("--path", options.path, "left out: posture drives to the goal")
    fitted = str(options.imu).lower()
    sensors = [f"sensors.{sensor}.fitted={fitted}" for sensor in ("gyro", "accelerometer")] if options.imu else []
    if options.rows and options.imu:
        raise refused("--imu", "with --rows", "left out: the rows name their sensors")
    scenario = Scenario(options.world, changes=[*options.set, *sensors], axles=options.axles)
    scenarios = scenario.rows(options.rows) if options.rows else [scenario]
    grounds = [Ground.parse(text) for text in options.ground or ["flat"]]
    path = options.path if options.task == "follow" else None
    rows = [Row(ground, it, path, options.impratio) for ground in (None, *grounds) for it in scenarios]

    title = "Posture regulation" if path is None else f"Path following, {options.path}"
    plural = "" if options.trials == 1 else "s"
    head = f"{title}, {options.trials} trial{plural} a row, seed {options.seed}, world {scenario.world}"
    results: list[list[Trial]] = [[] for _ in rows]
    jobs = [(row, options.seed, trial) for row in rows for trial in range(options.trials)]
    for done, result in enumerate(_all(jobs, options.threads)):
        results[done // options.trials].append(result)
        if sys.stderr.isatty():
            print(f"\r{done + 1} of {len(jobs)} trials", end="\n" if done + 1 == len(jobs) else "", file=sys.stderr)
    table = [list(COLUMNS), *(cells(row, trials) for row, trials in zip(rows, results))]
    text = "\n".join([head, "", *_aligned(table), *(f"{name}: {it}" for name, it in COLUMNS.items() if it)])
    if options.json == "-":
        print(text, file=sys.stderr)
    else:
        print(text)
    if options.json:
        _write_json(options, rows, results)
    if options.out is not None:
        written = media.write(options.out, rows, results, options.seed, options.gif)
        print(f"\nwrote {options.out}: {' '.join(written)}", file=sys.stderr if options.json == "-" else sys.stdout)
    failed = 0
    for row, trials in zip(rows, results):
        for number, trial in enumerate(trials):
            if trial.end not in SUCCESSES:
                failed = 1
                print(f"cfmmr.mujoco: {row.name}, {row.scenario.label}, trial {number}: {trial.end}: {trial.text}", file=sys.stderr)
    return failed


def _all(jobs: list[tuple[Row, int, int]], processes: int) -> Iterator[Trial]:
    """Results of the jobs in order."""
    if processes == 1:
        yield from map(_trial, jobs)
        return
    with ProcessPoolExecutor(min(processes, len(jobs))) as executor:
        try:
            yield from executor.map(_trial, jobs)
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise


def _trial(job: tuple[Row, int, int]) -> Trial:
    return run_trial(*job)[0]


def _aligned(table: list[list[str]]) -> list[str]:
    """Lines of a table whose first row is its head."""
    widths = [max(map(len, column)) for column in zip(*table)]
    lines = ["  ".join(cell.rjust(width) for cell, width in zip(row, widths)) for row in table]
    return [lines[0], "─" * len(lines[0]), *lines[1:]]


def _write_json(options: argparse.Namespace, rows: list[Row], results: list[list[Trial]]) -> None:
    def plain(trial: Trial) -> dict[str, object]:
        fields = asdict(trial)
        del fields["track"]
        return {name: None if value != value else value for name, value in fields.items()}

    table = [
        {"ground": row.name, "sensors": row.scenario.label, "trials": [plain(it) for it in trials]}
        for row, trials in zip(rows, results)
    ]
    text = json.dumps(table)
    if options.json == "-":
        print(text)
    else:
        Path(options.json).write_text(text + "\n")


if __name__ == "__main__":
    sys.exit(main())
