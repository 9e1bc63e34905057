"""Trials in MuJoCo and beside them in the plant, and their table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from .._native import Scenario
from ..pictures import polar
from ..runs import Log, run, run_path
from .grounds import Ground
from .robot import MuJoCoRobot

_ACCUSED = ("gauge lost", "sensor lost", "tracking lost", "inconsistent", "wheel slip")
"""Ends of the names of codes that blame a sensor or a wheel."""


@dataclass(frozen=True)
class Row:
    """A row of the table: the physics. ground: of MuJoCo; None for the plant of this project."""

    ground: Ground | None
    scenario: Scenario
    path: str | None
    """Path to follow; None to regulate to the goal."""
    impratio: float = 10.0

    @property
    def points(self) -> np.ndarray | str | None:
        """Waypoints of the path, shape (n, 2), m, or its name."""
        return sine(6.0) if self.path == "sine" else self.path

    @property
    def name(self) -> str:
        return "plant" if self.ground is None else str(self.ground)


@dataclass(frozen=True)
class Trial:
    """What the table needs of a trial."""

    end: str
    text: str
    """Reason of the end and notices."""
    accused: bool
    """True if a notice or the end blames a sensor or a wheel, though all are sound."""
    e_m: float
    heading_rad: float
    claim_m: float
    """95 % error of the position as the robot estimates it."""
    nees: float
    """Normalised estimation error squared at the end."""
    relative: tuple[float, float, float]
    """Root mean square errors of the estimated relative posture over the run: m, m, rad."""
    duration_s: float
    track: np.ndarray
    """True path of the midpoint, shape (n, 3), a row every 0.1 s."""


def run_trial(row: Row, seed: int, trial: int, robot: type[MuJoCoRobot] = MuJoCoRobot) -> tuple[Trial, Log]:
    """Runs a trial of a row."""
    path = row.points
    places = [row.scenario["mission.start"][:2], row.scenario["mission.goal"][:2]] if path is None else path
    longer_m = 0.8 * (row.scenario["robot.geometry.axles"] - 2)
    reach = {} if isinstance(places, str) else {"reach_m": 1 + np.abs(places).max() + longer_m}
    plant = None if row.ground is None else partial(robot, ground=row.ground, impratio=row.impratio, **reach)
    if path is None:
        log, end = run(row.scenario, seed, trial, plant=plant)
        e, heading = end["e_m"], end["heading_rad"]
    else:
        log, end = run_path(row.scenario, path, seed, trial, plant=plant)
        e, heading = end["final_m"], end["final_heading_rad"]
    truth, estimate = log["truth.robot"], log["lead.robot"]
    error = estimate[-1] - truth[-1]
    error[2] = _wrap(error[2])
    covariance = log["lead.robot.covariance"][-1]
    nees = error @ np.linalg.solve(covariance, error) if covariance[0, 0] > 0 else np.nan
    words = "; ".join(text for text in (end["notices"], end["reason"]) if text)
    blamed = any(name.strip().endswith(_ACCUSED) for name in end["notices"].split(";"))
    result = Trial(
        end=end["end"],
        text=" ".join(text for text in (end["code"], words) if text),
        accused=blamed or any(f"{word} (0x" in end["reason"] for word in _ACCUSED),
        e_m=e,
        heading_rad=heading,
        claim_m=end["error_95_m"],
        nees=float(nees),
        relative=_relative_rms(log),
        duration_s=end["duration_s"],
        track=truth[::10],
    )
    return result, log


def sine(length_m: float) -> np.ndarray:
    """Waypoints of a sine of amplitude 0.2 m and wavelength 2.5 m, from its first to about `length_m`, shape (n, 2)."""
    x = np.linspace(0, length_m, round(100 * length_m))
    y = 0.2 * np.sin(2 * np.pi * x / 2.5)
    length = np.concatenate([[0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    keep = length <= length_m
    return np.column_stack([x, y])[keep][::10]


def _relative_rms(log: Log) -> tuple[float, float, float]:
    """Root mean square errors of the estimated posture of the front axle in the coordinates of the rear axle."""
    front, rear = log["lead.front"], log["lead.rear"]
    known = log["lead.robot.covariance"][:, 0, 0] > 0
    d, sin, cos = front - rear, np.sin(rear[:, 2]), np.cos(rear[:, 2])
    relative = np.column_stack([cos * d[:, 0] + sin * d[:, 1], cos * d[:, 1] - sin * d[:, 0], d[:, 2]])
    # The estimate is one epoch old.
    error = relative[1:] - log["truth.relative"][:-1]
    error[:, 2] = _wrap(error[:, 2])
    x, y, phi = np.sqrt(np.mean(error[known[1:]] ** 2, axis=0)) if known.any() else (np.nan,) * 3
    return float(x), float(y), float(phi)


def _wrap(angle: Any) -> Any:
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


COLUMNS = {
    "ground": "",
    "sensors, fusion": "",
    "goal (cm)": "true distance from the goal at the end, mean ± standard deviation",
    "heading (°)": "true heading less that of the goal, mean of the magnitude",
    "claim (cm)": "95 % error of the position by the robot's own estimate, mean",
    "NEES": "normalised estimation error squared at the end, mean; 3 if the covariance is right",
    "relative (mm, mm, mrad)": "errors of the estimated relative posture of the axles over the run, root mean square",
    "time (s)": "mean",
    "blamed": "trials in which a code blames a sensor or a wheel; all are sound",
    "ends": "",
}
"""Columns of the table with their meaning."""


def cells(row: Row, trials: Sequence[Trial]) -> list[str]:
    """Cells of a row of the table."""
    e, nees = (np.array([getattr(trial, field) for trial in trials]) for field in ("e_m", "nees"))
    heading = np.mean([abs(trial.heading_rad) for trial in trials])
    relative = np.sqrt(np.mean([np.square(trial.relative) for trial in trials], axis=0))
    spread = f" ± {100 * e.std(ddof=1):.1f}" if len(e) > 1 else ""
    kinds, counts = np.unique([trial.end for trial in trials], return_counts=True)
    return [
        row.name,
        row.scenario.label,
        f"{100 * e.mean():.1f}{spread}",
        f"{np.degrees(heading):.2f}",
        f"{100 * np.mean([trial.claim_m for trial in trials]):.1f}",
        f"{nees.mean():.1f}",
        f"{1e3 * relative[0]:.2f}, {1e3 * relative[1]:.2f}, {1e3 * relative[2]:.1f}",
        f"{np.mean([trial.duration_s for trial in trials]):.1f}",
        str(sum(trial.accused for trial in trials)),
        ", ".join(f"{count} {kind}" for kind, count in zip(kinds, counts)),
    ]
