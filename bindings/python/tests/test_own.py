"""Controller and estimator of the user."""

import numpy as np
import pytest

from cfmmr import ControllerInput, EstimatorInput, InputError, Robot, RunError, run, run_many, trials
from conftest import Loop


REACHED = {"reached", "uncertain"}


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


class Polar:
    """Drives to the goal by its distance and bearing."""

    def begin(self):
        self.arrived = False

    def step(self, input):
        (dx, dy), phi = input.goal[:2] - input.posture[:2], input.posture[2]
        x, y = np.cos(phi) * dx + np.sin(phi) * dy, np.cos(phi) * dy - np.sin(phi) * dx
        distance, bearing = np.hypot(x, y), np.arctan2(y, x)
        self.arrived |= bool(distance < 0.01 or (distance < 0.1 and x < 0))
        if self.arrived:
            return 0.0, 0.0, True
        turn = 4 * bearing - 2 * wrapped(input.goal[2] - phi - bearing)
        return min(0.2, 0.5 * distance + 0.02), np.clip(turn / distance, -2.5, 2.5), False


def ahead(posture, by):
    c, s = np.cos(posture[2]), np.sin(posture[2])
    return posture + np.array([c * by[0] - s * by[1], s * by[0] + c * by[1], by[2]])


class Odometry:
    """Dead reckoning of both axles."""

    def start(self, center, relative):
        half = np.array([relative[0][0] / 2, 0, 0])
        self.front, self.rear = ahead(center[0], half), ahead(center[0], -half)

    def step(self, input):
        if input.front:
            self.front = ahead(self.front, input.front[0])
        if input.rear:
            self.rear = ahead(self.rear, input.rear[0])
        x, y, _ = self.front - self.rear
        middle = np.array([*(self.front + self.rear)[:2] / 2, np.arctan2(y, x)])
        return np.array([self.front, self.rear, middle]), np.array([1e-4 * np.eye(3)] * 3)


def test_polar_controller_reaches_the_goal(careful):
    table = run_many(careful, trials(31, 4), threads=2, controller=Polar)
    assert set(table["end"]) <= REACHED and table["e_m"].max() < 0.1


def test_dead_reckoning_reaches_the_goal(careful):
    table = run_many(careful, trials(31, 4), estimator=Odometry)
    assert set(table["end"]) <= REACHED and table["e_m"].max() < 0.3


def test_own_parts_work_in_a_loop_taken_apart(careful):
    log, _ = run(careful, 31, controller=Polar, estimator=Odometry)
    loop = Loop(careful, 31)
    loop.robot = Robot(careful, 31, controller=Polar, estimator=Odometry)
    loop.step(loop.settle)
    loop.robot.regulate()
    loop.step(3000)
    epoch = loop.ticks // 10 - 1
    assert np.array_equal(loop.robot.posture, log["lead.robot"][epoch])


def test_parts_receive_their_inputs(careful):
    seen = {}

    class Controller(Polar):
        def step(self, input):
            seen["controller"] = input
            return super().step(input)

    class Estimator(Odometry):
        def step(self, input):
            seen["estimator"] = input
            return super().step(input)

    run(careful, 31, controller=Controller, estimator=Estimator)
    controller, estimator = seen["controller"], seen["estimator"]
    assert isinstance(controller, ControllerInput) and isinstance(estimator, EstimatorInput)
    assert controller.posture.shape == controller.goal.shape == (3,) and len(controller.tolerance) == 2
    for posture, covariance in (estimator.front, estimator.rear, estimator.beam):
        assert posture.shape == (3,) and covariance.shape == (3, 3)


@pytest.mark.parametrize("kind", ["controller", "estimator"])
def test_exception_in_a_step_ends_the_run(careful, kind):
    class Part(Polar if kind == "controller" else Odometry):
        def step(self, input):
            raise ZeroDivisionError("mine")

    with pytest.raises(ZeroDivisionError, match="mine"):
        run(careful, 31, **{kind: Part})
    with pytest.raises(ZeroDivisionError, match="mine"):
        run_many(careful, trials(31, 4), threads=2, **{kind: Part})


@pytest.mark.parametrize("make", [lambda: 1 / 0, lambda number: number, 5])
@pytest.mark.parametrize("kind", ["controller", "estimator"])
def test_exception_in_the_maker_ends_the_run(careful, kind, make):
    with pytest.raises((ZeroDivisionError, TypeError)):
        run(careful, 31, **{kind: make})


@pytest.mark.parametrize("result", [None, 1, (1, 2), (0.1, 0.0, "yes", 1), ("a", 0.0, False), (0.1, None, False), 1j])
def test_wrong_result_of_a_controller_is_refused_by_name(careful, result):
    class Controller:
        def step(self, input):
            return result

    with pytest.raises(InputError) as refused:
        run(careful, 31, controller=Controller)
    assert refused.value.field == "result of controller.step"


POSTURES, COVARIANCES = np.zeros((3, 3)), np.array([np.eye(3)] * 3)


@pytest.mark.parametrize(
    "result, field",
    [
        (None, "result of estimator.step"),
        (POSTURES, "result of estimator.step"),
        ((POSTURES[0], COVARIANCES), "postures.shape"),
        ((POSTURES, COVARIANCES[0]), "covariances.shape"),
        ((1j * POSTURES, COVARIANCES), "postures"),
        ((POSTURES, "none"), "covariances"),
    ],
)
def test_wrong_result_of_an_estimator_is_refused_by_name(careful, result, field):
    class Estimator(Odometry):
        def step(self, input):
            return result

    with pytest.raises(InputError) as refused:
        run(careful, 31, estimator=Estimator)
    assert refused.value.field == field


@pytest.mark.parametrize("output", [(np.nan, 0.0, False), (0.1, np.inf, False), (1e300, 0.0, False)])
def test_controller_output_that_is_not_finite_stops_the_robot(careful, output):
    class Controller:
        def step(self, input):
            return output

    _, end = run(careful, 31, controller=Controller)
    assert end["reason"] == "the controller's velocity or curvature is not finite"


def test_estimate_that_is_not_finite_stops_the_robot(careful):
    class Estimator(Odometry):
        def step(self, input):
            return np.full((3, 3), np.nan), COVARIANCES

    _, end = run(careful, 31, estimator=Estimator)
    assert "not a number" in end["reason"]


@pytest.mark.parametrize("kind, part", [("controller", Polar), ("estimator", Odometry)])
def test_part_is_made_once_a_trial(careful, kind, part):
    made = []

    def make():
        made.append(part())
        return made[-1]

    run_many(careful, trials(31, 3), threads=2, **{kind: make})
    assert len(made) == 3


def test_controller_that_uses_its_robot_during_a_step_gets_an_error(careful):
    seen = []

    class Controller(Polar):
        def step(self, input):
            for use in (lambda: loop.robot.posture, loop.robot.stop, lambda: loop.robot.done):
                with pytest.raises(RunError, match="in progress"):
                    use()
            seen.append(True)
            return super().step(input)

    loop = Loop(careful, 31)
    loop.robot = Robot(careful, 31, controller=Controller)
    loop.step(loop.settle)
    loop.robot.regulate()
    loop.step(100)
    assert seen


def test_exception_in_a_step_taken_apart_is_raised_from_it(careful):
    class Controller:
        def step(self, input):
            raise LookupError("mine")

    loop = Loop(careful, 31)
    loop.robot = Robot(careful, 31, controller=Controller)
    loop.step(loop.settle)
    loop.robot.regulate()
    with pytest.raises(LookupError, match="mine"):
        loop.step(1000)
