"""Parts that several tests share."""

import os
from pathlib import Path

import numpy as np
import pytest

from cfmmr import Plant, Robot, Scenario

PACKAGE = Path(__file__).resolve().parents[1] / "python" / "cfmmr"


@pytest.fixture(scope="session")
def program() -> str:
    """Path of the program `cfmmr`."""
    path = os.environ.get("CFMMR", "")
    if not (path and os.access(path, os.X_OK)):
        pytest.fail(
            f"CFMMR={path!r}: set it to the path of the program: "
            "cargo build --release --package cfmmr; export CFMMR=$PWD/target/release/cfmmr",
            pytrace=False,
        )
    return path


@pytest.fixture(scope="session")
def careful() -> Scenario:
    return Scenario("careful")


@pytest.fixture(scope="session")
def inertial(careful) -> Scenario:
    """The careful world with gyroscopes and accelerometers."""
    return careful.changed("sensors.gyro.fitted=true", "sensors.accelerometer.fitted=true")


class Loop:
    """A trial taken apart: plant and robot, stepped from Python."""

    def __init__(self, scenario, seed, trial=0):
        self.plant, self.robot = Plant(scenario, seed, trial), Robot(scenario, seed, trial)
        self.sensed = np.empty(self.plant.sensed_count)
        self.torque = np.empty((len(self.plant.axles), 2))
        self.settle = round(scenario["mission.settle_s"] * 1000)
        self.ticks = 0

    def step(self, count=1, spoil=None):
        """Advances by `count` ms; `spoil` may change the sensed values."""
        for _ in range(count):
            self.plant.sensed_into(self.sensed)
            if spoil is not None:
                spoil(self.sensed)
            self.robot.step_into(self.sensed, self.torque)
            self.plant.step_with(self.torque)
            self.ticks += 1
