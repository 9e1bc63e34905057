"""Grounds for the robot in MuJoCo: flat, rough, with ridges or domes, sloped."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..runs import refused

if TYPE_CHECKING:
    import mujoco

KINDS = "flat, rough:MM[:LENGTH_M], ridges:MM, domes:MM or slope:DEG"
_BOUNDS = {"rough": (0.1, 50.0), "ridges": (0.1, 40.0), "domes": (0.1, 40.0), "slope": (0.0, 15.0)}
"""Smallest and largest size of each kind: mm, degrees for a slope."""
_LENGTH_M = (0.05, 5.0)
_CELL_M = 0.02
"""Distance of the heights of rough ground, m."""
_RIDGE_APART_M = (0.4, 0.8)
_DOMES_PER_M2 = 10.0


@dataclass(frozen=True)
class Ground:
    """Kind and size of a ground.

    size: standard deviation of the height (rough), height (ridges, domes), mm; angle (slope), degrees.
    length_m: correlation length of rough ground.
    """

    kind: str = "flat"
    size: float = 0.0
    length_m: float = 0.3

    @classmethod
    def parse(cls, text: str) -> Ground:
        """Ground of a text such as "rough:10:0.3"."""
        kind, *numbers = text.split(":")
        most = {"flat": 0, "rough": 2}.get(kind, 1)
        if kind not in {"flat", *_BOUNDS} or not min(most, 1) <= len(numbers) <= most:
            raise refused("ground", text, KINDS)
        if kind == "flat":
            return cls()
        ranges = ((kind, _BOUNDS[kind]), ("length", _LENGTH_M))
        values = []
        for number, (name, (least, most_allowed)) in zip(numbers, ranges):
            try:
                value = float(number)
            except ValueError:
                value = np.nan
            if not least <= value <= most_allowed:
                raise refused(f"ground.{name}", number, f"a number from {least:g} to {most_allowed:g}")
            values.append(value)
        return cls(kind, *values)

    def __str__(self) -> str:
        unit = "°" if self.kind == "slope" else " mm"
        return self.kind if self.kind == "flat" else f"{self.kind} {self.size:g}{unit}"

    def build(
        self, spec: mujoco.MjSpec, half_size_m: float, random: np.random.Generator
    ) -> Callable[[float, float], float]:
        """Adds the ground to a model; gives a function of its height (m) at a place (m, m)."""
        import mujoco

        if self.kind == "rough":
            return _rough(spec, 1e-3 * self.size, self.length_m, half_size_m, random)
        kinds = mujoco.mjtGeom
        spec.worldbody.add_geom(name="ground", type=kinds.mjGEOM_PLANE, size=[half_size_m, half_size_m, 1])
        if self.kind == "slope":
            # In the coordinates of the slope the ground is level and gravity is tilted.
            downhill, angle = random.uniform(-np.pi, np.pi), np.radians(self.size)
            sin, cos = np.sin(angle), np.cos(angle)
            spec.option.gravity = 9.81 * np.array([sin * np.cos(downhill), sin * np.sin(downhill), -cos])
        height = 1e-3 * self.size
        # A circular arc that is four times as wide as high.
        radius = 2.5 * height
        if self.kind == "ridges":
            heading = random.uniform(-np.pi, np.pi)
            along, across = (np.array([np.cos(angle), np.sin(angle)]) for angle in (heading, heading + np.pi / 2))
            place = -half_size_m + random.uniform(*_RIDGE_APART_M)
            while place < half_size_m:
                middle, reach = place * across, half_size_m * along
                ends = [[*(middle + sign * reach), height - radius] for sign in (-1, 1)]
                spec.worldbody.add_geom(
                    type=kinds.mjGEOM_CAPSULE, size=[radius, 0, 0], fromto=np.ravel(ends), name=f"ridge{place:.3f}"
                )
                place += random.uniform(*_RIDGE_APART_M)
        if self.kind == "domes":
            for k in range(round(_DOMES_PER_M2 * (2 * half_size_m) ** 2)):
                spec.worldbody.add_geom(
                    type=kinds.mjGEOM_SPHERE,
                    size=[radius, 0, 0],
                    pos=[*random.uniform(-half_size_m, half_size_m, 2), height - radius],
                    name=f"dome{k}",
                )
        top = height if self.kind in ("ridges", "domes") else 0.0
        return lambda x, y: top


FLAT = Ground()


def _rough(
    spec: mujoco.MjSpec, deviation: float, length: float, half_size: float, random: np.random.Generator
) -> Callable[[float, float], float]:
    """Gaussian heights with the correlation exp(−d²/2l²) of places d apart."""
    import mujoco

    count = int(np.ceil(2 * half_size / _CELL_M)) + 1
    frequency = np.fft.fftfreq(count, 2 * half_size / (count - 1))
    square = frequency[:, None] ** 2 + frequency**2
    filter = np.exp(-((np.pi * length) ** 2) * square)
    heights = np.fft.ifft2(np.fft.fft2(random.standard_normal((count, count))) * filter).real
    heights *= deviation / heights.std()
    heights -= heights.min()
    top = heights.max()
    spec.add_hfield(
        name="ground", size=[half_size, half_size, top, 0.1], nrow=count, ncol=count, userdata=np.ravel(heights / top)
    )
    spec.worldbody.add_geom(name="ground", type=mujoco.mjtGeom.mjGEOM_HFIELD, hfieldname="ground")

    def height(x: float, y: float) -> float:
        column, row = (round((value + half_size) / (2 * half_size) * (count - 1)) for value in (x, y))
        return float(heights[np.clip(row, 0, count - 1), np.clip(column, 0, count - 1)])

    return height
