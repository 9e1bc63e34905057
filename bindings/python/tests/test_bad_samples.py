"""Reaction of the boards to samples that no sensor gives (docs/codes.md)."""

import numpy as np
import pytest

from cfmmr import Boards, Plant, Scenario, drawn
from conftest import Loop

BAD = [np.nan, np.inf, -np.inf, 1e300, -1e300]
LEFT, YAW_RATE, ACCELERATION, STRAIN = 0, 2, 3, 8


def driven(scenario, entry, value, last, limit):
    """Robot after a drive in which a sensed value is spoilt from 5 s to `last` (ms)."""
    loop = Loop(scenario, 31)
    loop.step(loop.settle)
    loop.robot.regulate()
    loop.step(5000 - loop.settle)
    loop.step(last - 5000, spoil=lambda sensed: sensed.__setitem__(entry, value))
    while loop.ticks < limit and not (loop.robot.done or loop.robot.fault):
        loop.step(10)
        assert np.isfinite(loop.torque).all() and np.isfinite(loop.robot.posture).all()
    return loop.robot


@pytest.mark.parametrize("entry", [LEFT, YAW_RATE, ACCELERATION, STRAIN])
@pytest.mark.parametrize("value", BAD)
def test_one_bad_value_does_not_end_a_drive(inertial, entry, value):
    robot = driven(inertial, entry, value, 5001, 20_000)
    assert robot.done and robot.fault is None
    assert set(robot.notices) <= {"measurement refused"}


@pytest.mark.parametrize(
    "entry, value, fault, notice",
    [
        (LEFT, np.nan, "encoder fault (0xc1)", None),
        (LEFT, np.inf, "encoder fault (0xc1)", None),
        (LEFT, 1e300, "wheel slip (0x8d)", None),
        (YAW_RATE, np.nan, None, "measurement refused"),
        (YAW_RATE, 1e300, "wheel slip (0x8d)", None),
        (ACCELERATION, np.nan, None, "measurement refused"),
        (ACCELERATION, 1e300, None, "measurement refused"),
        (STRAIN, np.nan, None, "gauge lost"),
        (STRAIN, np.inf, None, "gauge lost"),
        (STRAIN, 1e300, None, "gauge lost"),
    ],
)
def test_lasting_bad_value_is_named(inertial, entry, value, fault, notice):
    robot = driven(inertial, entry, value, 6000, 6000)
    assert fault in robot.fault if fault else robot.fault is None
    assert notice is None or notice in robot.notices


class Samples:
    """Encoders, converters and inertial sensors without errors in place of those of a robot."""

    def __init__(self):
        self.scenario = Scenario("ideal")
        bridge = self.scenario["sensors.bridge"]
        self.plant, self.boards = Plant(self.scenario, 1), Boards(self.scenario, 1)
        self.zero = np.array(drawn(self.scenario, 1)["frames"][0]["bridge_offset"][:5])
        self.half = 2 ** (bridge["converter_bits"] - 1)
        share = bridge["gauge_factor"] * bridge["active_gauges"] / 4 * bridge["amplifier_gain"]
        self.per_strain = 2 * self.half * share
        self.sensed, self.ticks = np.empty(self.plant.sensed_count), 0
        self.per_turn = self.scenario["sensors.encoder.counts_per_revolution"]

    def step(self, count, spoil=None):
        for _ in range(count):
            self.plant.sensed_into(self.sensed)
            axles = self.sensed[:8].reshape(2, 4)
            samples = {
                "encoder": np.floor(axles[:, :2] / (2 * np.pi) * self.per_turn),
                "counts": np.round(self.half + (self.sensed[8:] + self.zero) * self.per_strain)[None],
                "gyro": axles[:, 2].copy(),
                "acceleration": axles[:, 3].copy(),
            }
            if spoil:
                samples[spoil[0]].flat[0] = spoil[1]
            self.plant.step_with(self.boards.step(**samples))
            self.ticks += 1

    def drive(self, spoil, last, limit):
        self.step(1500)
        self.boards.regulate()
        self.step(3500)
        self.step(last - 5000, spoil)
        while self.ticks < limit and not (self.boards.done or self.boards.fault):
            self.step(10)
        return self.boards


ONE = [(name, value) for name in ("gyro", "acceleration") for value in BAD]
ONE += [("encoder", np.nan), ("encoder", 2**31 - 1), ("encoder", -(2**31))]
ONE += [("counts", -1), ("counts", 0), ("counts", 4095), ("counts", 2**31 - 1)]


@pytest.mark.parametrize("name, value", ONE)
def test_one_bad_sample_does_not_end_a_drive(name, value):
    samples = Samples()
    boards = samples.drive((name, value), 5001, 20_000)
    assert boards.done and boards.fault is None
    assert set(boards.notices) <= {"measurement refused", "gauges inconsistent"}
    assert np.hypot(*samples.plant.midpoint[:2]) < 0.05


@pytest.mark.parametrize(
    "name, value, fault, notice",
    [
        ("encoder", np.nan, "encoder fault (0xc1)", None),
        ("encoder", 2**31 - 1, "wheel slip (0x8d)", None),
        ("gyro", np.nan, None, "measurement refused"),
        ("gyro", np.inf, "wheel slip (0x8d)", None),
        ("acceleration", 1e300, None, "measurement refused"),
        ("counts", -1, None, "gauge lost"),
        ("counts", 2**31 - 1, None, "gauge lost"),
        ("counts", 4095, "estimate inconsistent (0x85)", None),
    ],
)
def test_lasting_bad_sample_is_named(name, value, fault, notice):
    boards = Samples().drive((name, value), 6000, 6000)
    assert fault in boards.fault if fault else boards.fault is None
    assert notice is None or notice in boards.notices


def test_boards_without_inertial_sensors_drive():
    samples, torque = Samples(), None
    for _ in range(100):
        torque = samples.boards.step(np.zeros((2, 2)), np.full((1, 5), float(samples.half)), None, None)
    assert torque.shape == (2, 2) and np.isfinite(torque).all()
