"""Scenarios, keys, tables and frames."""

import pickle

import numpy as np
import pytest

import cfmmr
from cfmmr import InputError, Log, Scenario, frame, keys, run, run_many, summary, trials


@pytest.fixture(scope="module")
def table(careful):
    return run_many(careful.rows("pair"), trials(3, 4))


def test_summary_has_a_row_for_each_sensor_set(table):
    rows = summary(table)
    assert [row["rps"] for row in rows] == [False, True] and [row["trials"] for row in rows] == [4, 4]
    here = table["rps"] == 1
    assert rows[1]["e_m"] == pytest.approx(np.mean(table["e_m"][here]))
    assert rows[1]["e_m_sd"] == pytest.approx(np.std(table["e_m"][here], ddof=1))
    assert sum(rows[0]["ends"].values()) == 4


def test_summary_of_one_trial_has_no_deviation(careful):
    assert np.isnan(summary(run_many(careful, [3]))[0]["e_m_sd"])


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_frames_hold_the_columns(table, careful, library):
    found = frame(table, library)
    assert list(found.columns) == list(table) and found["e_m"].to_list() == table["e_m"].tolist()
    log, _ = run(careful, 3)
    flat = frame(log, library)
    assert "lead.robot.covariance[0][0]" in flat.columns or len(flat.columns) == len(log.flat())
    assert frame(summary(table), library)["trials"].to_list() == [4, 4]


def test_flat_and_of_are_inverse(careful):
    log, _ = run(careful, 3)
    again = Log.of(log.flat())
    assert list(again) == list(log)
    assert all(np.array_equal(again[name], log[name], equal_nan=log[name].dtype.kind == "f") for name in log)


def test_log_takes_columns_of_the_user_and_survives_pickle(careful):
    log, _ = run(careful, 3)
    count = len(log.flat())
    log["mine"] = np.zeros((len(log["time_s"]), 2))
    again = pickle.loads(pickle.dumps(log))
    assert isinstance(again, Log) and list(again.flat())[count:] == ["mine[0]", "mine[1]"]
    assert list(Log(a=np.zeros(2)).flat()) == ["a"]


def test_scenario_survives_pickle_repr_and_toml(careful):
    changed = careful.changed("plant.friction=0.5")
    assert pickle.loads(pickle.dumps(changed)) == changed != careful
    assert eval(repr(changed), {"Scenario": Scenario}) == changed
    assert Scenario(text=changed.toml())["plant.friction"] == 0.5
    assert changed.world == "careful, changed" and careful.world == "careful"
    with pytest.raises(TypeError):
        hash(changed)


def test_scenario_is_loaded_from_a_file(careful, tmp_path):
    (tmp_path / "a.toml").write_text(careful.changed("plant.friction=0.5").toml())
    loaded = Scenario.load(tmp_path / "a.toml", changes=["mission.rest_s=1.0"])
    assert loaded["plant.friction"] == 0.5 and loaded["mission.rest_s"] == 1.0


@pytest.mark.parametrize("world", cfmmr.worlds())
def test_every_world_makes_every_row(world):
    scenario = Scenario(world)
    assert scenario.world == world
    for rows in ("main", "pair", "joint", "all"):
        labels = [row.label for row in scenario.rows(rows)]
        assert len(set(labels)) == len(labels) > 1


def test_keys_describe_themselves():
    every = keys()
    assert len(every) > 200 and len({key.key for key in every}) == len(every)
    friction = next(key for key in every if key.key == "plant.friction")
    assert friction.range == (0.0, 3.0) and friction.meaning and not friction.whole
    table = keys("robot.limits")
    assert {key.key for key in table} == {key.key for key in every if key.key.startswith("robot.limits.")}


def test_value_beyond_the_range_of_its_key_is_refused():
    for key in keys("robot.limits"):
        if key.range:
            with pytest.raises(InputError) as refused:
                Scenario(changes=[f"{key.key}={key.range[1] * 2 + 1}"])
            assert refused.value.field == key.key
