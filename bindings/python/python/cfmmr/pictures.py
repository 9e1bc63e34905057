"""Pictures of trials as in the paper's figures 7 and 8. They need matplotlib: pip install 'cfmmr[pictures]'."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .runs import Log, refused

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Posture = Sequence[float]
ORIGIN = (0.0, 0.0, 0.0)
_TRUE, _ESTIMATED, _GOAL = "#0072b2", "#000000", "#009e73"
_SHOWN_FROM_M = 0.05
"""Smallest distance at which θ and α are drawn: nearer they are directions of millimetres."""


def paths(
    rows: Mapping[str, Sequence[Log | np.ndarray]] | Sequence[Log | np.ndarray],
    goal: Posture = ORIGIN,
) -> Figure:
    """Paths of trials, and their ends in the goal's coordinates: the paper's figure 7.

    rows: paths as `run_paths` gives them, or logs; a dict of such lists by title gives a column each.
    goal: m, m, rad, for example `scenario["mission.goal"]`.
    """
    rows = rows if isinstance(rows, Mapping) else {"": rows}
    figure, axes = _figure("Paths during posture regulation", rows, 2)
    for (title, trials), (above, below) in zip(rows.items(), axes.T):
        tracks = [_truth(trial) for trial in trials]
        if not tracks:
            raise refused(f"rows[{title!r}]", "no path", "at least one path")
        for track in tracks:
            above.plot(track[:, 0], track[:, 1], color=_TRUE, alpha=0.4, linewidth=0.8)
        starts, ends = (np.array([track[place] for track in tracks]) for place in (0, -1))
        _arrow(above, _mean(starts), 0.2, "s", "0.4", "start")
        _arrow(above, goal, 0.2, "o", _GOAL, "goal")
        _arrow(above, _mean(ends), 0.2, "x", _ESTIMATED, "mean end")
        _labels(above, title, "x (m)", "y (m)")
        ends = np.array([_in_goal(end, goal) for end in ends])
        for end in ends:
            _arrow(below, end, 3, ".", _TRUE, None)
        _arrow(below, (0, 0, 0), 3, "o", _GOAL, "goal")
        _arrow(below, _mean(ends), 3, "x", _ESTIMATED, "mean end")
        _labels(below, _count(len(ends)), "along the goal's heading (cm)", "across (cm)")
        for axis in (above, below):
            axis.set_aspect("equal", adjustable="datalim")
    axes[0, 0].legend(loc="upper left", fontsize="small")
    return figure


def errors(logs: Mapping[str, Log] | Log, goal: Posture = ORIGIN) -> Figure:
    """Errors e, θ and α over time, true and estimated: the paper's figure 8.

    logs: a log, or a dict of logs by title for a column each. goal: m, m, rad. θ and α are drawn at e of at least 5 cm.
    """
    columns = {"": logs} if isinstance(logs, Log) else logs
    figure, axes = _figure("Posture errors", columns, 3, sharex="col")
    for (title, log), column in zip(columns.items(), axes.T):
        for name, style in (("truth", {"color": _TRUE, "label": "true"}),
                            ("lead", {"color": _ESTIMATED, "linestyle": "--", "label": "estimated"})):
            e, theta, alpha = polar(log[f"{name}.robot"], goal)
            far = e >= _SHOWN_FROM_M
            column[0].plot(log["time_s"], e, **style)
            for axis, angle in zip(column[1:], (theta, alpha)):
                axis.plot(log["time_s"], _gaps(np.where(far, np.degrees(angle), np.nan)), **style)
        _labels(column[0], title, "", "e (m)")
        _labels(column[1], "", "", "θ (°)")
        _labels(column[2], "", "t (s)", "α (°)")
    axes[0, 0].legend(loc="upper right", fontsize="small")
    return figure


def polar(postures: np.ndarray, goal: Posture = ORIGIN) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of postures, shape (n, 3), in polar form.

    Distance e to the goal (m), direction θ of the goal, and α, that direction less the robot's heading (rad).
    """
    dx, dy = goal[0] - postures[:, 0], goal[1] - postures[:, 1]
    sight = np.arctan2(dy, dx)
    return np.hypot(dx, dy), _wrap(sight - goal[2]), _wrap(sight - postures[:, 2])


def _figure(title: str, columns: Mapping[str, Any], rows: int, **options: Any) -> tuple[Figure, np.ndarray]:
    if not columns:
        raise refused("columns", "none", "at least one row or log")
    try:
        import matplotlib.pyplot as pyplot
    except ImportError as error:
        raise ImportError("a picture needs the package matplotlib: pip install 'cfmmr[pictures]'") from error
    size = (5 * len(columns), 4 * rows if rows == 2 else 2.5 * rows)
    figure, axes = pyplot.subplots(rows, len(columns), figsize=size, squeeze=False, layout="constrained", **options)
    figure.suptitle(title)
    return figure, axes


def _labels(axis: Any, title: str, x: str, y: str) -> None:
    axis.set_title(title)
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    axis.grid(alpha=0.3)


def _arrow(axis: Any, posture: Posture, length: float, marker: str, color: str, label: str | None) -> None:
    """A point with a line along its heading."""
    x, y, heading = posture
    axis.plot([x, x + length * np.cos(heading)], [y, y + length * np.sin(heading)], color=color, linewidth=1)
    axis.plot([x], [y], marker, color=color, label=label)


def _truth(trial: Log | np.ndarray) -> np.ndarray:
    return trial["truth.robot"] if isinstance(trial, Log) else np.asarray(trial)


def _mean(postures: np.ndarray) -> tuple[float, float, float]:
    """Mean position and circular mean of the heading."""
    x, y, heading = postures.T
    return x.mean(), y.mean(), np.arctan2(np.sin(heading).mean(), np.cos(heading).mean())


def _in_goal(posture: Posture, goal: Posture) -> tuple[float, float, float]:
    """Posture in the goal's coordinates: cm, cm, rad."""
    dx, dy = posture[0] - goal[0], posture[1] - goal[1]
    sin, cos = np.sin(goal[2]), np.cos(goal[2])
    return 100 * (cos * dx + sin * dy), 100 * (cos * dy - sin * dx), posture[2] - goal[2]


def _wrap(angle: np.ndarray) -> np.ndarray:
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


def _gaps(degrees: np.ndarray) -> np.ndarray:
    """The line, interrupted where an angle wraps."""
    line = degrees.copy()
    line[1:][np.abs(np.diff(degrees)) > 180] = np.nan
    return line


def _count(trials: int) -> str:
    return f"end of {trials} trials" if trials > 1 else "end of the trial"
