"""The robot in MuJoCo: its model by hand calculation, grounds by statistics, drives by their ends."""

import csv
import json
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import mujoco
import numpy as np
import pytest

from cfmmr import InputError, Plant, Scenario, drawn_plant, run, run_path
from cfmmr.algorithms import strip_equilibrium
from cfmmr.mujoco import Ground, MuJoCoRobot, maker, media
from cfmmr.mujoco.__main__ import main, parser
from cfmmr.mujoco.grounds import FLAT
from cfmmr.mujoco.robot import model_of
from cfmmr.mujoco.trials import sine

GRAVITY = 9.81


@pytest.fixture(scope="module")
def free(careful):
    """A scenario whose wheels are free from the start."""
    return careful.changed("mission.settle_s=0")


@pytest.mark.parametrize("world", ["ideal", "careful", "ordinary"])
def test_model_is_the_drawn_robot(world):
    scenario = Scenario(world)
    robot, drawn = MuJoCoRobot(scenario, 5, 2), drawn_plant(scenario, 5, 2)
    plant, model = drawn["plant"], robot.model
    strip = 7850 * 12 * plant["bending_stiffness_n_m2"] / (2.05e11 * 1e-6) * plant["strip_length_m"]
    assert model.body_mass.sum() == pytest.approx(2 * 4.76 + 0.6 + strip, rel=1e-3)
    assert robot.midpoint == pytest.approx(drawn["start"], abs=1e-3)
    assert robot.relative[0] == pytest.approx([plant["strip_length_m"], 0, 0], abs=2e-4)
    for axle in range(2):
        wheels = [model.body(f"wheel{axle}.{side}") for side in range(2)]
        left, right = (robot.data.xpos[wheel.id] for wheel in wheels)
        assert np.linalg.norm(left - right) == pytest.approx(2 * plant["half_track_m"][axle])
        heights = robot.data.xpos[[wheel.id for wheel in wheels], 2]
        assert heights == pytest.approx(plant["wheel_radius_m"][axle], abs=2e-4)
        center = sum(wheel.mass[0] * height for wheel, height in zip(wheels, heights))
        body = model.body(f"axle{axle}")
        mass = body.mass[0] + sum(wheel.mass[0] for wheel in wheels)
        center += body.mass[0] * robot.data.xipos[body.id, 2]
        assert center / mass == pytest.approx(plant["center_of_mass_height_m"], abs=2e-3)


def test_yaw_inertia_of_an_axle_is_the_drawn_one(careful):
    robot = MuJoCoRobot(careful, 5)
    model, half_track = robot.model, drawn_plant(careful, 5)["plant"]["half_track_m"]
    for axle in range(2):
        wheels = [model.body(f"wheel{axle}.{side}") for side in range(2)]
        yaw = model.body(f"axle{axle}").inertia[2]
        yaw += sum(wheel.inertia[2] + wheel.mass[0] * half_track[axle] ** 2 for wheel in wheels)
        assert yaw == pytest.approx(0.0186, rel=1e-6)


def test_three_axles_stand_in_a_row(careful):
    drawn = drawn_plant(careful, 3)
    for name, value in drawn["plant"].items():
        if isinstance(value, list):
            value.append(value[-1])
    drawn["gauges_m"].append(drawn["gauges_m"][0])
    model = model_of(drawn, FLAT, 5.0, 10.0, np.random.default_rng(1))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    places = np.array([data.xpos[model.body(f"axle{axle}").id] for axle in range(3)])
    length = drawn["plant"]["strip_length_m"]
    assert np.linalg.norm(np.diff(places, axis=0), axis=1) == pytest.approx([length, length], abs=1e-3)
    assert places[:, 2] == pytest.approx(np.max(drawn["plant"]["wheel_radius_m"]), abs=1e-3)
    assert places[:, :2].mean(axis=0) == pytest.approx(drawn["start"][:2], abs=1e-3)


@pytest.mark.parametrize("axles", [3, 5])
def test_every_axle_of_a_chain_carries_its_weight_on_rough_ground(axles):
    robot = MuJoCoRobot(Scenario("careful", axles=axles), 31, ground=Ground.parse("rough:10"))
    for _ in range(1500):
        robot.step_with(np.zeros((axles, 2)))
    carried = np.zeros(axles)
    force = np.empty(6)
    for index, contact in enumerate(robot.data.contact):
        mujoco.mj_contactForce(robot.model, robot.data, index, force)
        wheel = max(contact.geom, key=lambda geom: robot.model.geom_bodyid[geom])
        name = robot.model.body(robot.model.geom_bodyid[wheel]).name
        carried[int(name[len("wheel") :].split(".")[0])] += force[0]
    mean = robot.model.body_mass.sum() * GRAVITY / axles
    assert carried.sum() == pytest.approx(axles * mean, rel=0.05)
    assert carried == pytest.approx(mean, rel=0.4)


@pytest.mark.parametrize(("left", "right"), [(0.25, -0.25), (-0.3, 0.2)])
def test_strains_are_those_of_the_exact_strip(careful, free, left, right):
    robot, drawn = MuJoCoRobot(free, 31), drawn_plant(careful, 31)
    sensed = np.empty(13)
    # Turns the front axle until friction and strip hold it.
    for _ in range(600):
        robot.step_with(np.array([[left, right], [0.0, 0.0]]))
    robot._hold(True)
    for _ in range(500):
        robot.step_with(np.zeros((2, 2)))
    robot.sensed_into(sensed)
    assert abs(robot.relative[0, 2]) > 0.1, "bent"
    plant, places = drawn["plant"], np.array([0.1, 0.3, 0.5, 0.7, 0.9])
    length, bending = plant["strip_length_m"], plant["bending_stiffness_n_m2"]
    near = sensed[8:] / drawn["half_thickness_m"]
    exact = strip_equilibrium(length, bending, plant["axial_stiffness_n"], robot.relative[0], near)["curvature"]
    curve = np.polynomial.Polynomial.fit(places * length, exact, 4)
    strain = drawn["half_thickness_m"] * curve(np.array(drawn["gauges_m"][0]))
    assert sensed[8:] == pytest.approx(strain, abs=0.02 * np.abs(strain).max())


def test_wheels_roll_without_slip(free):
    robot, sensed = MuJoCoRobot(free, 31), np.empty(13)
    begin = robot.midpoint[0]
    for _ in range(1500):
        robot.step_with(np.full((2, 2), 0.08))
    robot.sensed_into(sensed)
    way = np.mean(sensed[[0, 1, 4, 5]] * np.ravel(drawn_plant(free, 31)["plant"]["wheel_radius_m"]))
    assert robot.midpoint[0] - begin == pytest.approx(way, rel=2e-3) and way > 0.05


def test_robot_coasts_down_a_slope_as_gravity_and_rolling_resistance_command(careful):
    angle, scenario = np.radians(4), careful.changed("plant.slope_rad=0.06981317", "mission.settle_s=0")
    robot = MuJoCoRobot(scenario, 31)
    robot.step_with(np.zeros((2, 2)))
    begin, ticks = robot.midpoint[0], 500
    for _ in range(ticks):
        robot.step_with(np.zeros((2, 2)))
    plant = drawn_plant(scenario, 31)["plant"]
    mass = robot.model.body_mass.sum()
    turning = 4 * plant["wheel_inertia_kg_m2"] / np.mean(plant["wheel_radius_m"]) ** 2
    resistance = plant["rolling_resistance"] * GRAVITY * (2 * 4.76 + 0.6)
    acceleration = (mass * GRAVITY * np.sin(angle) - resistance) / (mass + turning)
    assert robot.midpoint[0] - begin == pytest.approx(0.5 * acceleration * (1e-3 * ticks) ** 2, rel=0.03)


def test_gyro_and_accelerometer_feel_turn_and_slope(careful):
    sensed = np.empty(13)
    robot = MuJoCoRobot(careful.changed("plant.slope_rad=0.05", "plant.downhill_rad=3.14159265"), 31)
    robot.step_with(np.zeros((2, 2)))
    robot.sensed_into(sensed)
    # Nose uphill: the specific force points forward.
    assert sensed[[3, 7]] == pytest.approx(GRAVITY * np.sin(0.05), abs=0.02)
    robot = MuJoCoRobot(careful.changed("mission.settle_s=0"), 31)
    headings = []
    for _ in range(300):
        robot.step_with(np.array([[-0.1, 0.1], [-0.1, 0.1]]))
        headings.append(robot.axles[:, 2])
    robot.sensed_into(sensed)
    assert sensed[[2, 6]] == pytest.approx((headings[-1] - headings[-3]) / 2e-3, abs=0.02)


def test_rough_ground_has_the_given_height_and_length():
    heights = []
    for seed in range(3):
        spec = mujoco.MjSpec()
        height = Ground.parse("rough:12:0.25").build(spec, 6.0, np.random.default_rng(seed))
        places = np.arange(-5.9, 5.9, 0.125)
        heights.append([[height(x, y) for x in places] for y in places])
    heights = np.array(heights)
    assert heights.std() == pytest.approx(0.012, rel=0.1)
    heights -= heights.mean(axis=(1, 2), keepdims=True)
    correlation = (heights[:, 2:] * heights[:, :-2]).mean() / heights.var()
    assert correlation == pytest.approx(np.exp(-0.5), abs=0.06)


@pytest.mark.parametrize("text", ["rough:10", "ridges:10", "domes:10"])
def test_ground_is_drawn_by_seed_and_trial(careful, text):
    def places(seed, trial):
        model = MuJoCoRobot(careful, seed, trial, Ground.parse(text)).model
        return np.concatenate([model.geom_pos[model.geom_contype > 0].ravel(), model.hfield_data])

    assert np.array_equal(places(1, 1), places(1, 1))
    assert not any(np.array_equal(places(1, 1), places(*other)) for other in ((1, 2), (2, 1)))


@pytest.mark.parametrize(
    "text", ["sand", "flat:1", "rough", "rough:0", "rough:nan", "rough:10:0", "rough:1:1:1", "ridges:50", "slope:x", ""]
)
def test_bad_ground_is_refused(text):
    with pytest.raises(InputError) as error:
        Ground.parse(text)
    assert error.value.field.startswith("ground") and error.value.allowed


def test_goal_is_reached_on_the_flat_with_the_accuracy_of_the_plant(careful):
    own, other = (run(careful, 31, plant=plant) for plant in (None, maker()))
    assert own[1]["end"] == other[1]["end"] == "reached"
    assert other[1]["e_m"] < 0.03 and other[1]["notices"] == ""
    assert np.isfinite(other[0]["truth.wheel_speed_rad_s"]).all()


def test_plant_of_the_project_as_a_simulator_gives_the_bits_of_run(careful):
    (log, end), (same, other) = run(careful, 31, 2), run(careful, 31, 2, plant=Plant)
    assert all(log[name].tobytes() == same[name].tobytes() for name in log)
    assert {name for name in end if end[name] != other[name]} == {"force_rms_n"}
    (log, end), (same, other) = (run_path(careful, "line", 7, plant=plant) for plant in (None, Plant))
    assert all(log[name].tobytes() == same[name].tobytes() for name in log) and end == other


def test_path_ends_where_its_points_end(careful):
    points = sine(2.0)
    assert np.hypot(*np.diff(points, axis=0).T).sum() == pytest.approx(2.0, abs=0.1)
    log, end = run_path(careful, points, 3, plant=maker())
    assert end["end"] in ("reached", "uncertain")
    assert log["truth.robot"][-1, :2] == pytest.approx(points[-1], abs=0.06)
    assert end["final_m"] == pytest.approx(np.hypot(*(log["truth.robot"][-1, :2] - points[-1])), abs=2e-3)


class Broken:
    """A simulator that fails after a second."""

    midpoint = np.zeros(3)
    axles = np.zeros((2, 3))

    def __init__(self, scenario, seed, trial):
        self.ticks = 0

    def sensed_into(self, out):
        out[:] = 0

    def step_with(self, torque):
        self.ticks += 1
        if self.ticks == 1000:
            raise ArithmeticError("diverged")


def test_exception_of_a_simulator_ends_the_run(careful):
    with pytest.raises(ArithmeticError, match="diverged"):
        run(careful, 1, plant=Broken)


@pytest.mark.parametrize("attribute", [{"axles": np.zeros((3, 3))}, {"midpoint": "here"}, {"sensed_into": None}])
def test_simulator_of_wrong_form_is_refused(careful, attribute):
    with pytest.raises((InputError, TypeError)):
        run(careful, 1, plant=type("Wrong", (Broken,), attribute))


def test_command_prints_a_row_for_plant_and_ground(capsys, tmp_path):
    arguments = ["--trials", "2", "--seed", "31", "--threads", "1", "--set", "mission.start=[-0.4, 0, 0]"]
    assert main(["posture", *arguments, "--ground", "rough:5", "--out", str(tmp_path / "out")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0].strip() or line.split()[0] for line in lines[4:6]] and "2 reached" in lines[4]
    assert any(line.strip().startswith("rough 5 mm") for line in lines)
    with open(tmp_path / "out/trials.csv") as file:
        rows = list(csv.DictReader(file))
    assert [(row["ground"], row["trial"]) for row in rows] == [
        ("plant", "0"), ("plant", "1"), ("rough 5 mm", "0"), ("rough 5 mm", "1")
    ]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["errors.png", "paths.png", "trials.csv"]


def test_command_gives_the_same_result_on_any_number_of_processes():
    def result(threads):
        command = [sys.executable, "-m", "cfmmr.mujoco", "posture", "--set", "mission.start=[-0.4, 0, 0]"]
        options = ["--trials", "2", "--json", "-", "--threads", threads]
        return subprocess.run([*command, *options], check=True, capture_output=True).stdout

    one = result("1")
    assert one == result("2") and len(json.loads(one)[1]["trials"]) == 2


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["posture", "--ground", "rough:0"], "ground.rough = 0: must be a number from 0.1 to 50"),
        (["posture", "--trials", "0"], "--trials = 0: must be a whole number of at least 1"),
        (["posture", "--gif"], "--gif = without --out"),
        (["posture", "--path", "line"], "--path = line: must be left out"),
        (["follow", "--world", "nowhere"], "nowhere"),
        (["posture", "--impratio", "0"], "--impratio = 0.0"),
        (["posture", "--set", "plant.friction=-1"], "plant.friction"),
    ],
)
def test_command_refuses_bad_input(capsys, arguments, text):
    assert main(arguments) == 2
    captured = capsys.readouterr()
    assert text in captured.err and captured.out == ""


def test_commands_of_the_page_are_right():
    page = (Path(__file__).resolve().parents[3] / "docs/mujoco.md").read_text()
    commands = re.findall(r"^python -m cfmmr.mujoco (.*)$", page, re.MULTILINE)
    assert len(commands) >= 2
    for command in commands:
        options = parser().parse_args(command.split())
        assert [Ground.parse(text) for text in options.ground]


def test_missing_mujoco_is_named():
    code = "import sys; sys.modules['mujoco'] = None; import cfmmr.mujoco"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert "pip install 'cfmmr[mujoco]'" in result.stderr


def test_mujoco_is_the_pinned_version():
    (pinned,) = [it for it in metadata.requires("cfmmr") if it.startswith("mujoco")]
    assert pinned.split(";")[0].strip() == f"mujoco=={mujoco.__version__}"


def test_film_shows_the_robot_or_says_what_is_missing(careful):
    robot = MuJoCoRobot(careful, 1)
    try:
        picture = media.Camera(robot.model).picture(robot.data, robot.data.xpos[robot.model.body("axle0").id])
    except media.MediaError as error:
        assert "apt-get install libegl1" in str(error)
        return
    colours = np.unique(np.asarray(picture.convert("RGB")).reshape(-1, 3), axis=0)
    redness = colours[:, 0].astype(int) - colours[:, 2]
    # The front axle is blue, the rear axle orange; everything else is nearly grey.
    assert len(colours) > 10 and redness.min() < -40 and redness.max() > 30, colours
