"""Pictures of the paper's figures, and what they are drawn from."""

import sys

import matplotlib
import numpy as np
import pytest

from cfmmr import InputError, pictures, run, run_many, run_paths, summary, trials

matplotlib.use("Agg")


def test_paths_are_those_of_the_runs_on_any_threads(careful):
    few = trials(31, 3)
    expected = [run(careful, *trial)[0]["truth.robot"] for trial in few]
    for threads in (1, 3):
        paths = run_paths(careful, few, threads)
        assert all(np.array_equal(path, log) for path, log in zip(paths, expected, strict=True))


def test_polar_errors_are_those_of_the_end(careful):
    log, end = run(careful.changed("mission.goal=[0.1, 0.2, 0.3]"), 31)
    e, theta, alpha = pictures.polar(log["truth.robot"], (0.1, 0.2, 0.3))
    assert np.allclose([e[-1], theta[-1], alpha[-1]], [end["e_m"], end["theta_rad"], end["alpha_rad"]], atol=1e-12)


def test_ends_are_drawn_in_the_goals_coordinates():
    # 1 cm ahead of the goal and 2 cm to its right.
    figure = pictures.paths([np.array([[0, 0, 0], [1.02, 1.01, 1.0]])], (1, 1, np.pi / 2))
    assert any(np.allclose(line.get_xydata()[0], [1, -2]) for line in figure.axes[1].lines)


def test_angles_near_the_goal_are_not_drawn(careful):
    log, _ = run(careful, 31)
    e, theta, _ = (line.get_ydata() for line in (axis.lines[0] for axis in pictures.errors(log).axes))
    assert np.isnan(theta[e < 0.05]).all() and not np.isnan(theta[:100]).any()


@pytest.mark.parametrize("draw", [pictures.paths, pictures.errors])
def test_picture_of_nothing_is_refused(draw):
    with pytest.raises(InputError, match="at least one"):
        draw({})


def test_row_without_paths_is_refused():
    with pytest.raises(InputError, match="at least one path"):
        pictures.paths({"a": []})


def test_missing_matplotlib_is_named(monkeypatch, careful):
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    with pytest.raises(ImportError, match=r"pip install 'cfmmr\[pictures\]'"):
        pictures.paths([np.zeros((2, 3))])


def test_mean_of_angles_is_circular(careful):
    table = run_many(careful, trials(31, 2))
    table["theta_rad"] = np.array([np.pi - 0.1, -np.pi + 0.1])
    (row,) = summary(table)
    assert abs(abs(row["theta_rad"]) - np.pi) < 1e-12
    # For small angles the sample standard deviation.
    assert row["theta_rad_sd"] == pytest.approx(0.1 * np.sqrt(2), rel=5e-3)


def test_standard_deviation_of_one_trial_is_unknown(careful):
    (row,) = summary(run_many(careful, [31]))
    assert all(np.isnan(row[f"{name}_sd"]) for name in ("e_m", "theta_rad", "alpha_rad"))
