"""Files of a command: table, pictures, films."""

from __future__ import annotations

import csv
import re
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
from PIL import Image

from .. import pictures
from .robot import MuJoCoRobot
from .trials import Row, Trial, run_trial

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FRAMES_PER_S = 5
_SIZE = (420, 260)
"""Width and height of a film, pixels."""
_COLOURS = 48
"""Colours of a film."""


class MediaError(Exception):
    """A picture or film that cannot be made."""


def write(folder: Path, rows: list[Row], results: list[list[Trial]], seed: int, gif: bool) -> list[str]:
    """Writes table, pictures and, if wanted, films; gives their names."""
    films = {f"{_name(row)}.gif": _film(row, seed) for row in rows if gif and row.ground is not None}
    drawn = _pictures(rows, results, seed)
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "trials.csv", "w", newline="") as file:
        names = [field.name for field in fields(Trial) if field.name not in ("track", "relative")]
        writer = csv.writer(file)
        writer.writerow(["ground", "sensors", "trial", *names, "relative_x_m", "relative_y_m", "relative_phi_rad"])
        for row, trials in zip(rows, results):
            for number, trial in enumerate(trials):
                values = [getattr(trial, name) for name in names]
                writer.writerow([row.name, row.scenario.label, number, *map(_cell, values), *map(_cell, trial.relative)])
    for name, figure in drawn.items():
        figure.savefig(folder / f"{name}.png", dpi=100)
    for name, frames in films.items():
        first, *rest = frames
        first.save(folder / name, save_all=True, append_images=rest, duration=1000 // FRAMES_PER_S, loop=0)
    return ["trials.csv", *(f"{name}.png" for name in drawn), *films]


def _pictures(rows: list[Row], results: list[list[Trial]], seed: int) -> dict[str, Figure]:
    """Paths of all trials; of regulation also the errors in the first trial of the last row."""
    tracks = {_title(row): [trial.track for trial in trials] for row, trials in zip(rows, results)}
    if rows[0].path is None:
        goal = rows[0].scenario["mission.goal"]
        _, log = run_trial(rows[-1], seed, 0)
        return {"paths": pictures.paths(tracks, goal), "errors": pictures.errors({_title(rows[-1]): log}, goal)}
    ends = np.array([track[-1] for some in tracks.values() for track in some])
    points, goal = rows[0].points, ends.mean(axis=0)
    if not isinstance(points, str):
        goal = np.array([*points[-1], np.arctan2(*(points[-1] - points[-2])[::-1])])
    figure = pictures.paths(tracks, goal)
    figure.suptitle(f"Path following: {rows[0].path}")
    for axis in figure.axes[: len(rows)]:
        if not isinstance(points, str):
            axis.plot(*points.T, color="0.6", linestyle=":", linewidth=1)
    return {"paths": figure}


def _cell(value: object) -> object:
    """Value in a table: unknown is empty."""
    return "" if value != value else int(value) if isinstance(value, bool) else value


def _title(row: Row) -> str:
    return f"{row.name}: {row.scenario.label}"


def _name(row: Row) -> str:
    """Name of a file."""
    return re.sub(r"[^\w.]+", "-", f"{row.name} {row.scenario.label}".replace("°", " degrees"))


class Camera:
    """Renders a model without a display. It looks at the robot from behind its left side and follows it."""

    def __init__(self, model: mujoco.MjModel):
        try:
            from mujoco.egl import GLContext

            self._context = GLContext(*_SIZE)
            self._context.make_current()
        except Exception as error:
            raise MediaError(
                f"a film needs OpenGL without a display (Debian: apt-get install libegl1 libgl1-mesa-dri): {error}"
            ) from error
        model.vis.global_.offwidth, model.vis.global_.offheight = _SIZE
        self._model, self._options, self._view = model, mujoco.MjvOption(), mujoco.MjvCamera()
        self._view.distance, self._view.azimuth, self._view.elevation = 1.3, 130, -25
        self._scene = mujoco.MjvScene(model, maxgeom=5000)
        self._renderer = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._renderer)

    def picture(self, data: mujoco.MjData, middle: np.ndarray) -> Image.Image:
        self._view.lookat[:] = middle
        everything = mujoco.mjtCatBit.mjCAT_ALL
        mujoco.mjv_updateScene(self._model, data, self._options, None, self._view, everything, self._scene)
        pixels, place = np.empty((*_SIZE[::-1], 3), np.uint8), mujoco.MjrRect(0, 0, *_SIZE)
        mujoco.mjr_render(place, self._scene, self._renderer)
        mujoco.mjr_readPixels(pixels, None, place, self._renderer)
        return Image.fromarray(pixels[::-1]).quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE)


def _film(row: Row, seed: int) -> list[Image.Image]:
    """Frames of the first trial of a row."""
    frames: list[Image.Image] = []

    class Filmed(MuJoCoRobot):
        def __init__(self, *arguments: Any, **options: Any):
            super().__init__(*arguments, **options)
            self._camera, self._ticks = Camera(self.model), 0

        def step_with(self, torque: np.ndarray) -> None:
            super().step_with(torque)
            self._ticks += 1
            if self._ticks % (1000 // FRAMES_PER_S) == 0:
                frames.append(self._camera.picture(self.data, self.data.xpos[self._axles].mean(axis=0)))

    run_trial(row, seed, 0, Filmed)
    return frames
