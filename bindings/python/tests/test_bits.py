"""Runs from Python give the bits of the program."""

import subprocess
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest

import cfmmr
from cfmmr import InputError, Scenario, read, run, run_many, trials
from conftest import Loop


def same(first, second):
    """True if both columns hold the same values; an empty cell is NaN or an empty text."""
    if first.dtype.kind == second.dtype.kind == "U":
        return np.array_equal(first, second)
    if "U" in (first.dtype.kind, second.dtype.kind):
        words, numbers = (first, second) if first.dtype.kind == "U" else (second, first)
        return bool((words == "").all() and np.isnan(numbers).all())
    return np.array_equal(first.astype(float), second.astype(float), equal_nan=True)


def assert_same(first, second):
    assert list(first) == list(second)
    assert [name for name in first if not same(first[name], second[name])] == []


def posture(program, out, *arguments):
    subprocess.run([program, "posture", "--out", out, *arguments], check=True, capture_output=True)


def apart(scenario, seed, trial):
    """Estimates with covariances and true postures by epoch, from a trial taken apart."""
    loop, estimate, rows = Loop(scenario, seed, trial), np.empty(12), []
    rest, done = round(scenario["mission.rest_s"] * 1000), None
    while loop.ticks < 95_000:
        if loop.ticks == loop.settle:
            loop.robot.regulate()
        loop.step(10)
        loop.robot.estimate_into(estimate)
        rows.append([*estimate, *loop.plant.midpoint])
        if not loop.robot.done:
            done = None
        elif done is None:
            done = loop.ticks
        elif loop.ticks - done >= rest:
            break
    return np.array(rows)


@pytest.mark.parametrize(
    "world, rows, count",
    [("careful", "pair", 20), ("paper", "main", 4), ("ordinary", "joint", 4), ("ideal", "pair", 2)],
)
def test_table_equals_that_of_the_program(program, tmp_path, world, rows, count):
    arguments = ["--world", world, "--rows", rows, "--trials", str(count), "--seed", "31"]
    posture(program, tmp_path, *arguments)
    table = run_many(Scenario(world).rows(rows), trials(31, count))
    assert (table.pop("seed") == 31).all()
    assert_same(table, read(tmp_path / "trials.csv"))


@pytest.mark.parametrize("row", [0, 1])
def test_log_equals_the_csv_of_the_program(program, tmp_path, careful, row):
    rows = [["--no-rps"], []][row]
    posture(program, tmp_path, "--trials", "1", "--seed", "31", "--csv", tmp_path / "epochs.csv", *rows)
    log, _ = run(careful.rows("pair")[row], 31)
    assert_same(log.flat(), read(tmp_path / "epochs.csv").flat())


@pytest.mark.parametrize("row", [0, 1])
def test_trial_taken_apart_equals_run(careful, row):
    scenario = careful.rows("pair")[row]
    for trial in range(20):
        log, _ = run(scenario, 31, trial)
        rows = apart(scenario, 31, trial)
        assert np.array_equal(rows[:, :3], log["lead.robot"])
        assert np.array_equal(rows[:, 3:12].reshape(-1, 3, 3), log["lead.robot.covariance"])
        assert np.array_equal(rows[:, 12:], log["truth.robot"])


@pytest.mark.parametrize("world", ["careful", "ordinary", "paper"])
def test_trial_with_inertial_sensors_taken_apart_equals_run(world):
    scenario = Scenario(world).rows("joint")[1]
    assert "IMU" in scenario.label or scenario["sensors.gyro.fitted"]
    log, _ = run(scenario, 7, 3)
    rows = apart(scenario, 7, 3)
    assert np.array_equal(rows[:, :3], log["lead.robot"])
    assert np.array_equal(rows[:, 12:], log["truth.robot"])


@pytest.mark.parametrize("threads", [2, 3])
def test_number_of_threads_does_not_change_the_table(careful, threads):
    rows = careful.rows("pair")
    assert_same(run_many(rows, trials(5, 7), threads=1), run_many(rows, trials(5, 7), threads=threads))


def test_processes_do_not_change_the_table(careful):
    rows = careful.rows("joint")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        table = run_many(rows, trials(5, 5), executor=executor, block=2)
    assert_same(run_many(rows, trials(5, 5)), table)


def test_run_is_a_row_of_run_many(careful):
    _, end = run(careful, 31, 2)
    table = run_many(careful, [(31, 2)])
    for name, value in end.items():
        found = table[name][0]
        assert found == value or (found != found and value != value) or (found == "" and value != value), name


def test_large_seeds_and_trials_keep_all_digits(careful):
    pairs = [(2**53 + 1, 2**53 + 3), (2**62 + 1, 0)]
    table = run_many(careful, pairs)
    assert table["seed"].tolist() == [2**53 + 1, 2**62 + 1] and table["trial"].tolist() == [2**53 + 3, 0]
    last = 2**64 - 1
    table = run_many(careful, [(last, last)])
    assert table["seed"].tolist() == table["trial"].tolist() == [last]
    assert run(careful, last, last)[1]["trial"] == last


def test_drawn_robot_is_that_of_its_seed(careful):
    assert cfmmr.drawn(careful, 1) == cfmmr.drawn(careful, 1) != cfmmr.drawn(careful, 2)
    start = cfmmr.drawn_plant(careful, 31, 4)["start"]
    assert np.allclose(start, cfmmr.Plant(careful, 31, 4).midpoint, atol=1e-9)


def test_three_axles_have_columns_of_each_axle():
    scenario = Scenario(axles=3).changed("mission.time_limit_s=1")
    assert scenario["robot.geometry.axles"] == 3
    log, _ = run(scenario, 1)
    for name in ("truth.front", "truth.axle-2.axle", "truth.beam-2.relative", "lead.axle-2"):
        assert log[name].shape == (len(log["time_s"]), 3)
    apart = np.linalg.norm(log["truth.axle-2.axle"][0, :2] - log["truth.front"][0, :2])
    assert apart == pytest.approx(0.37, abs=2e-3)
    assert len(scenario.rows("all")) == 2, "fusions of one pair are left out"
    with pytest.raises(InputError, match="robot.geometry.axles"):
        Scenario(axles=6)
