"""Trials of posture regulation, their logs and tables."""

import json
import os
import re
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np

from numpy.typing import ArrayLike

from . import _native
from ._native import InputError, Scenario

_INDEX = re.compile(r"\[(\d+)\]")
_POSTURE = ("x_m", "y_m", "phi_rad")

Make = Callable[[], Any]
"""Class, or function that makes an object."""
MakePlant = Callable[[Scenario, int, int], Any]
"""Function that makes the simulator of a scenario, a seed and a trial."""


class _Parts(NamedTuple):
    """Functions that make the user's parts of a trial."""

    controller: Make | None = None
    estimator: Make | None = None
    plant: MakePlant | None = None


class Log(dict[str, np.ndarray]):
    """Columns of a run by name, a row an epoch of 10 ms.

    Lists and matrices are one array, for example `log["lead.robot.covariance"]` of shape (n, 3, 3). A posture is one
    array too: `log["truth.robot"]` of shape (n, 3), m, m, rad. NaN where a value is unknown. `cfmmr topics` prints unit
    and meaning of each column.
    """

    _names: dict[str, np.ndarray] = {}
    """Names of the columns in each array."""

    def flat(self) -> dict[str, np.ndarray]:
        """Columns of one dimension, with the names of `cfmmr posture --csv`."""
        columns: dict[str, np.ndarray] = {}
        for name, values in self.items():
            values, names = np.asarray(values), self._names.get(name)
            for index in np.ndindex(values.shape[1:]):
                own = name + "".join(f"[{place}]" for place in index)
                columns[own if names is None else str(names[index])] = values[(slice(None), *index)]
        return columns

    @classmethod
    def of(cls, columns: dict[str, np.ndarray]) -> "Log":
        """A log of columns as `flat` gives them."""
        log = cls()
        groups: dict[str, list[tuple[tuple[int, ...], str]]] = {}
        for name in columns:
            base, index = _place(name)
            groups.setdefault(base, []).append((index, name))
        log._names = {}
        for base, members in groups.items():
            shape = tuple(max(index[k] for index, _ in members) + 1 for k in range(len(members[0][0])))
            first = np.asarray(columns[members[0][1]])
            names = np.empty(shape, dtype=object)
            values = np.empty((len(first), *shape), dtype=first.dtype if not shape else np.float64)
            for index, name in members:
                values[(slice(None), *index)] = columns[name]
                names[index] = name
            log[base], log._names[base] = values, names
        return log


def _place(name: str) -> tuple[str, tuple[int, ...]]:
    """Name of the array that holds a column, and the place in it."""
    indices = tuple(int(number) for number in _INDEX.findall(name))
    if indices:
        return name[: name.index("[")], indices
    base, _, end = name.rpartition(".")
    return (base, (_POSTURE.index(end),)) if base and end in _POSTURE else (name, ())


def run(
    scenario: Scenario,
    seed: int,
    trial: int = 0,
    *,
    controller: Make | None = None,
    estimator: Make | None = None,
    plant: MakePlant | None = None,
) -> tuple[Log, dict[str, Any]]:
    """Trial `trial` of `cfmmr posture --seed SEED` in a scenario.

    controller, estimator: class, or function that makes an object, of the user's own (docs/python.md).
    plant: function of scenario, seed and trial that makes a simulator to be used in place of `Plant`, with the same
    methods `sensed_into` and `step_with` and properties `midpoint` and `axles`; `wheel_speeds`, `torques`, `relative`
    and `wrenches` are logged if it has them.
    Returns the log and the end: kind of the end, final errors and estimate, as in trials.csv.
    """
    columns, end = _native.run_columns(scenario, seed, trial, _Parts(controller, estimator, plant))
    return Log.of({name: np.asarray(values) for name, values in columns.items()}), end


def run_path(
    scenario: Scenario,
    path: str | os.PathLike[str] | ArrayLike,
    seed: int,
    trial: int = 0,
    *,
    laps: int = 1,
    timed: bool = False,
    controller: Make | None = None,
    estimator: Make | None = None,
    plant: MakePlant | None = None,
) -> tuple[Log, dict[str, Any]]:
    """A run along a path, from its first point to rest at its last one.

    path: line, circle, figure-eight or a CSV file of waypoints, as for `cfmmr follow`; or waypoints, shape (n, 2), m.
    laps: of a closed path. timed: as a trajectory, as `cfmmr track`. controller, estimator, plant: as for `run`.
    Returns the log from the beginning of the task, and the end: kind of the end, and path errors of the true and (names
    with "est") of the estimated midpoint.
    """
    path = os.fspath(path) if isinstance(path, os.PathLike) else path
    parts = _Parts(controller, estimator, plant)
    columns, end = _native.path_columns(scenario, path, laps, timed, seed, trial, parts)
    return Log.of({name: np.asarray(values) for name, values in columns.items()}), end


def run_paths(
    scenario: Scenario,
    trials: Iterable[tuple[int, int] | int],
    threads: int | None = None,
    *,
    controller: Make | None = None,
    estimator: Make | None = None,
    plant: MakePlant | None = None,
) -> list[np.ndarray]:
    """True path of the midpoint in each trial, shape (n, 3): m, m, rad, a row an epoch.

    trials, threads, controller, estimator, plant: as for `run_many`.
    """
    pairs = [pair if isinstance(pair, tuple) else (pair, 0) for pair in trials]
    threads = _threads(threads)

    def path(pair: tuple[int, int]) -> np.ndarray:
        log, _ = run(scenario, *pair, controller=controller, estimator=estimator, plant=plant)
        return log["truth.robot"]

    with ThreadPoolExecutor(threads) as executor:
        jobs = [executor.submit(path, pair) for pair in pairs]
        try:
            return [job.result() for job in jobs]
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            raise


def trials(seed: int, count: int) -> list[tuple[int, int]]:
    """Trials 0 to count - 1 of a seed, for `run_many`."""
    return [(seed, trial) for trial in range(count)]


def run_many(
    scenarios: Scenario | Iterable[Scenario],
    trials: Iterable[tuple[int, int] | int],
    threads: int | None = None,
    executor: Executor | None = None,
    block: int = 8,
    *,
    controller: Make | None = None,
    estimator: Make | None = None,
    plant: MakePlant | None = None,
) -> dict[str, np.ndarray]:
    """Table of trials by column, a row a trial: all trials of the first scenario, then of the next.

    Each trial is a pair (seed, trial), or a seed alone for its trial 0. They run on `threads` threads (by default one a
    core), or in blocks of `block` trials on an executor of `concurrent.futures`, whose workers need this package.
    Neither changes a bit of the result. controller, estimator, plant: as for `run`; made once a trial.
    """
    scenarios = [scenarios] if isinstance(scenarios, Scenario) else list(scenarios)
    pairs = [pair if isinstance(pair, tuple) else (pair, 0) for pair in trials]
    if not scenarios or not pairs:
        raise refused("trials", f"{len(scenarios)} scenarios, {len(pairs)} trials", "at least one of each")
    if executor is None:
        return _arrays(_native.run_rows(scenarios, pairs, _threads(threads), _Parts(controller, estimator, plant)))
    if threads is not None:
        raise refused("threads", threads, "None with an executor, which has its own workers")
    if block < 1:
        raise refused("block", block, "a whole number of at least 1")
    blocks = [pairs[first : first + block] for first in range(0, len(pairs), block)]
    own = _Parts(controller, estimator, plant)
    jobs = [executor.submit(_native.run_rows, [scenario], part, 1, own) for scenario in scenarios for part in blocks]
    try:
        tables = [_arrays(job.result()) for job in jobs]
    except BaseException:
        for job in jobs:
            job.cancel()
        raise
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _threads(threads: int | None) -> int:
    threads = (os.cpu_count() or 1) if threads is None else threads
    if threads < 1:
        raise refused("threads", threads, "a whole number of at least 1")
    return threads


def _arrays(table: dict[str, Any]) -> dict[str, np.ndarray]:
    return {name: np.asarray(values) for name, values in table.items()}


def refused(field: str, value: object, allowed: str) -> InputError:
    """Exception for a refused argument."""
    error = InputError(f"{field} = {value}: must be {allowed}")
    error.field, error.value, error.allowed = field, str(value), allowed
    return error


def summary(table: dict[str, np.ndarray]) -> list[dict[str, Any]]:
    """Rows of the paper's Table 1: number, mean and standard deviation of e (m), θ and α (rad), and ends by kind.

    A row for each sensor set and fusion of the table, in its order. Means and standard deviations of angles are
    circular, as in `cfmmr paper`; the standard deviation of one trial is NaN.
    """
    rows = []
    sets = list(zip(table["rps"], table["imu"], table["fusion"]))
    for rps, imu, fusion in dict.fromkeys(sets):
        here = [one == (rps, imu, fusion) for one in sets]
        row: dict[str, Any] = {"rps": bool(rps), "imu": bool(imu), "fusion": str(fusion), "trials": sum(here)}
        for name, measure in (("e_m", _linear), ("theta_rad", _circular), ("alpha_rad", _circular)):
            row[name], row[f"{name}_sd"] = measure(table[name][here])
        kinds, counts = np.unique(table["end"][here], return_counts=True)
        row["ends"] = dict(zip(kinds.tolist(), counts.tolist()))
        rows.append(row)
    return rows


def _linear(values: np.ndarray) -> tuple[float, float]:
    """Mean and standard deviation."""
    return float(values.mean()), float(values.std(ddof=1)) if len(values) > 1 else float("nan")


def _circular(angles: np.ndarray) -> tuple[float, float]:
    """Circular mean and standard deviation √(−2 ln R) of angles, rad (Mardia and Jupp, 2000, section 2.3)."""
    n = len(angles)
    sin, cos = float(np.sin(angles).mean()), float(np.cos(angles).mean())
    if n < 2:
        return float(np.arctan2(sin, cos)), float("nan")
    spread = np.sqrt(-2 * np.log(min(np.hypot(sin, cos), 1.0)))
    # n − 1 in the denominator: the sample standard deviation of small angles.
    return float(np.arctan2(sin, cos)), float(spread * np.sqrt(n / (n - 1)))


def frame(columns: dict[str, Any] | list[dict[str, Any]], library: str = "pandas") -> Any:
    """A table, a log or the rows of a summary as a frame of pandas or polars."""
    if library not in ("pandas", "polars"):
        raise refused("library", library, "pandas or polars")
    columns = columns.flat() if isinstance(columns, Log) else columns
    if library == "polars":
        import polars

        return polars.DataFrame(columns)
    import pandas

    return pandas.DataFrame(columns)


def drawn(scenario: Scenario, seed: int, trial: int = 0) -> dict[str, Any]:
    """Errors of the robot that is drawn for a seed and a trial: wheels, sensors, gauges, plant, placement."""
    errors: dict[str, Any] = json.loads(_native.drawn_json(scenario, seed, trial))
    return errors


def drawn_plant(scenario: Scenario, seed: int, trial: int = 0) -> dict[str, Any]:
    """What a model of the drawn robot needs: constants of the plant, true start, true places of the gauges.

    Keys: plant (keys of the table `plant`, with an entry for each axle), start (m, m, rad), gauges_m (by frame, from
    the root of the strip, m), half_thickness_m (strain over curvature, m).
    """
    constants: dict[str, Any] = json.loads(_native.drawn_plant_json(scenario, seed, trial))
    return constants
