"""Files of a command: table, pictures, films."""

from __future__ import annotations

import csv
from dataclasses import fields
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from PIL import Image

from .. import pictures
from .robot import MuJoCoRobot
from .trials import Row, Trial, run_trial

FRAMES_PER_S = 5
_SIZE = (420, 260)
_COLOURS = 48
"""Width and height of a film, pixels."""


class MediaError(Exception):
    """A picture or film that cannot be made."""


def write(folder: Path, rows: list[Row], results: list[list[Trial]], seed: int, gif: bool) -> list[str]:
    """Writes table, pictures and, if wanted, films; gives their names."""
    films = {f"{_name(row)}.gif": _film(row, seed) for row in rows if gif and row.ground is not None}
    _, log = run_trial(rows[-1], seed, 0)
    goal = rows[0].scenario["mission.goal"] if rows[0].path is None else results[0][0].track[-1]
    drawn = {
        "paths": pictures.paths({row.name: [it.track for it in trials] for row, trials in zip(rows, results)}, goal),
        "errors": pictures.errors({rows[-1].name: log}, goal),
    }
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "trials.csv", "w", newline="") as file:
        names = [field.name for field in fields(Trial) if field.name not in ("track", "relative")]
        writer = csv.writer(file)
        writer.writerow(["ground", "trial", *names, "relative_x_m", "relative_y_m", "relative_phi_rad"])
        for row, trials in zip(rows, results):
            for number, trial in enumerate(trials):
                values = [getattr(trial, name) for name in names]
                writer.writerow([row.name, number, *map(_cell, values), *map(_cell, trial.relative)])
    for name, figure in drawn.items():
        figure.savefig(folder / f"{name}.png", dpi=100)
    for name, frames in films.items():
        first, *rest = frames
        first.save(folder / name, save_all=True, append_images=rest, duration=1000 // FRAMES_PER_S, loop=0)
    return ["trials.csv", *(f"{name}.png" for name in drawn), *films]


def _cell(value: object) -> object:
    """Value in a table: unknown is empty."""
    return "" if value != value else int(value) if isinstance(value, bool) else value


def _name(row: Row) -> str:
    return row.name.replace(" ", "-").replace("°", "-degrees")


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
        return Image.fromarray(pixels[::-1]).quantize(_COLOURS, dither=Image.Dither.NONE)


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
