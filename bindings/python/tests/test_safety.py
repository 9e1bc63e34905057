"""Many objects, threads and signals."""

import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from cfmmr import Plant, Robot
from conftest import Loop


def in_threads(*jobs):
    errors = []

    def caught(job):
        try:
            job()
        except BaseException as error:
            errors.append(error)

    threads = [threading.Thread(target=caught, args=(job,)) for job in jobs]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not any(thread.is_alive() for thread in threads), "deadlock"
    assert errors == []


def test_thousand_plants_step_in_several_threads(careful):
    plants = [Plant(careful, seed) for seed in range(1000)]
    torque = np.full((2, 2), 0.2)

    def step(part):
        for _ in range(100):
            for plant in part:
                plant.step_with(torque)

    in_threads(*(lambda part=plants[k::4]: step(part) for k in range(4)))
    assert {plant.time_s for plant in plants} == {0.1}
    alone = Plant(careful, 500)
    alone.steps(100, torque)
    assert np.array_equal(alone.midpoint, plants[500].midpoint)


def test_hundred_robots_step_in_several_threads(careful):
    robots = [Robot(careful, seed) for seed in range(100)]
    sensed = np.zeros(robots[0].sensed_count)

    def step(part):
        torque = np.empty((2, 2))
        for _ in range(100):
            for robot in part:
                robot.step_into(sensed, torque)

    in_threads(*(lambda part=robots[k::4]: step(part) for k in range(4)))
    assert [robot.time_s for robot in robots] == pytest.approx([0.1] * 100)


def test_threads_take_turns_with_one_plant(careful):
    plant = Plant(careful, 1)
    zero = [[0.0, 0.0], [0.0, 0.0]]

    def step():
        for _ in range(300):
            plant.step_with(zero)

    def look():
        for _ in range(300):
            assert plant.midpoint.shape == (3,) and plant.time_s >= 0.0

    in_threads(step, step, look, look, lambda: plant.steps(20_000, zero))
    assert plant.time_s == pytest.approx(20.6)


def test_objects_dropped_while_another_thread_steps(careful):
    kept, stop = Loop(careful, 1), threading.Event()

    def drop():
        while not stop.is_set():
            Plant(careful, 2).steps(10, np.zeros((2, 2)))
            Loop(careful, 3).step(3)

    def step():
        kept.step(2000)
        stop.set()

    in_threads(step, drop)
    alone = Loop(careful, 1)
    alone.step(2000)
    assert np.array_equal(alone.plant.midpoint, kept.plant.midpoint)


def test_plant_dropped_by_its_last_owner_during_steps(careful):
    owners = [Plant(careful, 1)]

    def steps():
        owners[0].steps(200_000, np.zeros((2, 2)))

    in_threads(steps, lambda: (time.sleep(0.02), owners.__setitem__(0, Plant(careful, 2))))


@pytest.mark.parametrize(
    "call",
    [
        "while True: cfmmr.run(S, 1)",
        "cfmmr.run_many(S, cfmmr.trials(1, 100_000), threads=1)",
        "cfmmr.run_many(S, cfmmr.trials(1, 100_000), threads=2)",
        "cfmmr.Plant(S, 1).steps(10**18, [[0, 0], [0, 0]])",
        "cfmmr.run_many(S, cfmmr.trials(1, 1000), threads=2, controller=Rest)",
    ],
)
def test_interrupt_ends_the_call(call):
    program = f"""
import cfmmr, os, signal, threading
class Rest:
    def step(self, input): return 0.0, 0.0, False
S = cfmmr.Scenario("careful")
threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
try:
    {call}
except KeyboardInterrupt:
    print("interrupted")
"""
    # Each call takes hours if nothing ends it.
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stdout) == (0, "interrupted\n"), done.stderr


def test_interrupt_keeps_the_default_handler():
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
