"""Files of a command: table, pictures, films."""

from __future__ import annotations

import csv
import os
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .. import pictures
from .trials import Row, Trial, run_trial

if TYPE_CHECKING:
    import numpy as np

FRAMES_PER_S = 10
_SIZE = (480, 320)
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


def _film(row: Row, seed: int) -> list[Any]:
    """Frames of the first trial of a row."""
    os.environ.setdefault("MUJOCO_GL", "egl")
    try:
        import mujoco
        from PIL import Image

        from .robot import MuJoCoRobot
    except ImportError as error:
        raise MediaError(f"a film needs the package pillow: pip install 'cfmmr[mujoco]' ({error})") from error

    frames = []

    class Filmed(MuJoCoRobot):
        def __init__(self, *arguments: Any, **options: Any):
            super().__init__(*arguments, **options)
            try:
                self._renderer = mujoco.Renderer(self.model, _SIZE[1], _SIZE[0])
            except Exception as error:
                raise MediaError(
                    f"a film needs OpenGL without a display (Debian: apt-get install libegl1 libgl1-mesa-dri): {error}"
                ) from error
            self._camera = mujoco.MjvCamera()
            self._camera.distance, self._camera.azimuth, self._camera.elevation = 1.3, 130, -25
            self._ticks = 0

        def step_with(self, torque: np.ndarray) -> None:
            super().step_with(torque)
            self._ticks += 1
            if self._ticks % (1000 // FRAMES_PER_S) == 0:
                self._camera.lookat[:] = self.data.xpos[self._axles].mean(axis=0)
                self._renderer.update_scene(self.data, self._camera)
                frames.append(Image.fromarray(self._renderer.render()))

    run_trial(row, seed, 0, Filmed)
    return frames
