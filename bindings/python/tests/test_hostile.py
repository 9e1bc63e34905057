"""Wrong arguments are refused by name, and odd arrays are read as what they are."""

import math

import numpy as np
import pytest

import cfmmr
import cfmmr.algorithms as algorithms
from cfmmr import Boards, InputError, Plant, Robot, RunError, Scenario, run, run_many

S = Scenario("careful")
P3, P7 = 1e-2 * np.eye(3), 1e-2 * np.eye(7)
FIT, LAW, CASCADE = algorithms.StrainFit(S), algorithms.KinematicLaw(S), algorithms.Cascade(S)
DYNAMIC, PLANNER = algorithms.DynamicLaw(S), algorithms.Planner(S)
AT = np.array([0.5, -0.25, 0.125])


def on(make, use, read):
    """Result of a call on a new object."""

    def call(value):
        thing = make()
        use(thing, value)
        return read(thing)

    return call


def plant():
    return Plant(S, 1)


def robot():
    return Robot(S, 1)


def stepped(robot, value):
    torque = np.empty((2, 2))
    robot.step_into(value, torque)
    return torque


def boards(**arguments):
    return Boards(S, 1).step(**{"encoder": np.zeros((2, 2)), "counts": np.full((1, 5), 8192.0), **arguments})


def dynamic(**arguments):
    zero = {"posture": AT, "twist": [0, 0], "reference": AT, "reference_twist": [0, 0]}
    return DYNAMIC.torques(**{**zero, **arguments})


def intersection(**arguments):
    return algorithms.covariance_intersection(
        **{"a": AT, "a_covariance": P3, "b": -AT, "b_covariance": 2 * P3, **arguments}
    )


def axle_filter():
    return algorithms.AxleFilter(S)


def ipec():
    return algorithms.Ipec(S, [0.36, 0, 0], [0, 0, 0])


def fusion(*arguments, **step):
    made = algorithms.Fusion(S, *arguments)
    if step:
        made.step(**step)
    return made.robot


# Name of the argument in errors, call with it, good value, True if NaN and infinity are allowed.
ARRAYS = {
    "Plant.place": ("midpoint", on(plant, Plant.place, lambda p: p.midpoint), AT, False),
    "Plant.step_with": ("torque", on(plant, Plant.step_with, lambda p: p.wheel_speeds), np.eye(2), True),
    "Plant.steps": ("torque", on(plant, lambda p, v: p.steps(20, v), lambda p: p.wheel_speeds), np.eye(2), True),
    "Robot.regulate": ("goal", on(robot, Robot.regulate, lambda r: r.done), AT, False),
    "Robot.follow": ("points", on(robot, Robot.follow, lambda r: r.done), np.array([[0.0, 0], [1, 0], [2, 0]]), False),
    "Robot.step_into": ("sensed", lambda v: stepped(robot(), v), np.arange(13.0) * 2**-16, True),
    "Boards.step encoder": ("encoder", lambda v: boards(encoder=v), np.array([[1.0, 2], [3, 4]]), True),
    "Boards.step counts": ("counts", lambda v: boards(counts=v), np.arange(8190.0, 8195)[None], False),
    "Boards.step gyro": ("gyro", lambda v: boards(gyro=v), np.array([0.5, 0.25]), True),
    "Boards.step acceleration": ("acceleration", lambda v: boards(acceleration=v), np.array([0.5, 0.25]), True),
    "StrainFit.fit": ("strain", lambda v: FIT.fit(v)["posture"], np.arange(5) * 2.0**-14, False),
    "StrainFit.postures": ("strain", FIT.postures, np.arange(15).reshape(3, 5) * 2.0**-14, False),
    "AxleFilter state": ("state", lambda v: algorithms.AxleFilter(S, v).state, np.arange(7) / 8, False),
    "AxleFilter covariance": ("covariance", lambda v: algorithms.AxleFilter(S, None, v).covariance, np.eye(7), False),
    "AxleFilter.update_posture": (
        "posture",
        on(axle_filter, lambda f, v: f.update_posture(v, P3), lambda f: f.state),
        AT / 64,
        False,
    ),
    "AxleFilter.update_posture covariance": (
        "covariance",
        on(axle_filter, lambda f, v: f.update_posture(AT / 64, v), lambda f: f.state),
        np.eye(3),
        False,
    ),
    "intersection a": ("a", lambda v: intersection(a=v)[1], AT, False),
    "intersection A": ("a_covariance", lambda v: intersection(a_covariance=v)[1], np.eye(3), False),
    "intersection b": ("b", lambda v: intersection(b=v)[1], AT, False),
    "intersection B": ("b_covariance", lambda v: intersection(b_covariance=v)[1], np.eye(3), False),
    "Ipec axle1": ("axle1", lambda v: algorithms.Ipec(S, v, [9, 9, 0]).postures, AT, False),
    "Ipec axle2": ("axle2", lambda v: algorithms.Ipec(S, [9, 9, 0], v).postures, AT, False),
    "Ipec.step advance": (
        "advance",
        on(ipec, lambda i, v: i.step(v, [-0.36, 0, 0]), lambda i: i.postures),
        np.arange(4) / 64,
        False,
    ),
    "Ipec.step relative": ("relative", on(ipec, lambda i, v: i.step(np.zeros(4), v), lambda i: i.postures), -AT, False),
    "Fusion posture": ("posture", lambda v: fusion(v)[0], AT, False),
    "Fusion covariance": ("covariance", lambda v: fusion(AT, v)[1], np.eye(3), False),
    "Fusion.step front": ("front[0]", lambda v: fusion(front=(v, P3))[0], AT / 64, False),
    "Fusion.step rear": ("rear[1]", lambda v: fusion(rear=(AT, v))[0], np.eye(3), False),
    "Fusion.step beam": ("beam[0]", lambda v: fusion(beam=(v, P3))[0], AT / 64, False),
    "KinematicLaw postures": ("postures", lambda v: LAW.command(v, [0, 0, 0]), AT, False),
    "KinematicLaw many postures": ("postures", lambda v: LAW.command(v, [0, 0, 0]), np.array([AT, -AT]), False),
    "KinematicLaw reference": ("reference", lambda v: LAW.command([0, 0, 0], v), AT, False),
    "Cascade midpoint": ("midpoint", lambda v: CASCADE.references(v, 0.1, 0.1)[0], AT, False),
    "DynamicLaw posture": ("posture", lambda v: dynamic(posture=v), AT, False),
    "DynamicLaw twist": ("twist", lambda v: dynamic(twist=v), np.array([0.5, 0.25]) / 8, False),
    "DynamicLaw reference": ("reference", lambda v: dynamic(reference=v), AT, False),
    "DynamicLaw reference_twist": ("reference_twist", lambda v: dynamic(reference_twist=v), AT[:2] / 8, False),
    "DynamicLaw acceleration": ("acceleration", lambda v: dynamic(acceleration=v), AT[:2], False),
    "DynamicLaw load": ("load", lambda v: dynamic(load=v), AT, False),
    "Planner posture": ("posture", lambda v: PLANNER.plan(v, [0, 0, 0]), np.array([-0.5, 0, 0]), False),
    "Planner goal": ("goal", lambda v: PLANNER.plan([0, 0, 0], v), np.array([0.5, 0, 0]), False),
}
NONE_ALLOWED = {
    "Robot.regulate",
    "Boards.step gyro",
    "Boards.step acceleration",
    "AxleFilter state",
    "AxleFilter covariance",
    "Fusion posture",
    "Fusion covariance",
    "DynamicLaw acceleration",
    "DynamicLaw load",
}
each = pytest.mark.parametrize("case", ARRAYS)


def outcome(call, value):
    """Result of a call, or its exception, to be compared."""
    try:
        return repr(call(value))
    except InputError as error:
        return f"{error.field} = {error.value}: {error.allowed}"


def released():
    view = memoryview(np.zeros(3))
    view.release()
    return view


@each
def test_wrong_shape_is_refused(case):
    name, call, good, _ = ARRAYS[case]
    free = name == "postures" or case in ("StrainFit.postures", "Robot.follow")
    wrong = [good[..., :-1], good[None, None], np.zeros(0), good.tolist()[0], np.broadcast_to(0.0, (10**9,))]
    for value in [*wrong, *([] if free else [np.concatenate([good, good])])]:
        if name == "postures" and np.shape(value) == (3,):
            continue
        with pytest.raises(InputError) as refused:
            call(value)
        assert refused.value.field == f"{name}.shape", np.shape(value)
        assert refused.value.value == str(list(np.shape(value))) and refused.value.allowed


@each
def test_wrong_type_is_refused(case):
    name, call, good, _ = ARRAYS[case]
    wrong = [
        good.astype(complex),
        good.astype(str),
        good.astype(object),
        good.astype("m8[s]"),
        released(),
        "words",
        {},
        object(),
        [[1], [1, 2]],
        np.array([None] * 3),
    ]
    for value in [*wrong, *([] if case in NONE_ALLOWED else [None])]:
        with pytest.raises(InputError) as refused:
            call(value)
        assert refused.value.field == name and refused.value.value
        # A path may be a name.
        named = case == "Robot.follow" and isinstance(value, str)
        assert refused.value.allowed.startswith("line, circle" if named else "an array of real numbers")


@each
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_number_that_is_not_finite_is_refused_or_allowed(case, bad):
    name, call, good, allowed = ARRAYS[case]
    value = good.copy()
    value.flat[-1] = bad
    if allowed and not ("encoder" in case and np.isinf(bad)):
        result = call(value)
        assert np.isfinite(result).all()
    else:
        with pytest.raises(InputError) as refused:
            call(value)
        assert refused.value.field.startswith(f"{name}[") and refused.value.value.lower() in ("nan", "inf", "-inf")


@each
def test_huge_number_is_refused_or_bounded(case):
    name, call, good, allowed = ARRAYS[case]
    value = good.copy()
    value.flat[-1] = 1e300
    try:
        result = call(value)
    except InputError as error:
        assert name.split(".")[0] in error.field or error.field in ("x", "y")
    else:
        assert allowed and np.isfinite(result).all()


@each
@pytest.mark.parametrize(
    "dtype", ["int8", "int64", "uint16", "float16", "float32", "longdouble", "bool", ">f8", ">i4", ">f4"]
)
def test_real_numbers_of_any_type_are_converted(case, dtype):
    _, call, good, _ = ARRAYS[case]
    value = np.abs(good).astype(dtype)
    assert outcome(call, value) == outcome(call, value.astype(float))


@each
def test_layout_of_an_array_does_not_matter(case):
    _, call, good, _ = ARRAYS[case]
    wanted = outcome(call, good)
    wide = np.repeat(good, 2, axis=-1)[..., ::2]
    backward = np.ascontiguousarray(np.flip(good))[tuple(slice(None, None, -1) for _ in good.shape)]
    fixed = good.copy()
    fixed.flags.writeable = False
    odd = np.frombuffer(b"x" + good.tobytes(), np.uint8)[1:].view(float).reshape(good.shape)
    for value in (
        wide,
        backward,
        np.asfortranarray(good),
        fixed,
        odd,
        good.tolist(),
        memoryview(np.ascontiguousarray(good)),
    ):
        assert outcome(call, value) == wanted


OUTPUTS = {
    "Plant.sensed_into": (plant, Plant.sensed_into, (13,)),
    "Robot.step_into": (robot, lambda r, out: r.step_into(np.zeros(13), out), (2, 2)),
    "Robot.estimate_into": (robot, Robot.estimate_into, (12,)),
    "Boards.estimate_into": (lambda: Boards(S, 1), Boards.estimate_into, (12,)),
}
outputs = pytest.mark.parametrize("case", OUTPUTS)


@outputs
def test_array_that_cannot_be_written_is_refused(case):
    make, call, shape = OUTPUTS[case]
    thing, good = make(), np.zeros(shape)
    fixed = good.copy()
    fixed.flags.writeable = False
    wrong = [
        None,
        1.0,
        good.tolist(),
        bytearray(8),
        good.astype("f4"),
        good.astype(">f8"),
        good.astype(complex),
        good.astype(int),
        good[None],
        good[:1],
        np.zeros(0),
        fixed,
        np.broadcast_to(0.0, shape),
        np.broadcast_to(0.0, (10**9,)),
        released(),
    ]
    for value in wrong:
        before = thing.time_s
        with pytest.raises(InputError) as refused:
            call(thing, value)
        assert refused.value.field.startswith(("out", "torque")) and thing.time_s == before
    assert not good.any() and not fixed.any()


@outputs
def test_output_of_any_layout_is_written_in_order(case):
    make, call, shape = OUTPUTS[case]
    wanted = np.full(shape, np.nan)
    call(make(), wanted)
    assert np.isfinite(wanted).all()
    wide, flipped = np.full((*shape[:-1], 2 * shape[-1]), 7.0), np.full(shape, 7.0)
    for value in (wide[..., ::2], flipped[::-1], np.full(shape, 7.0, order="F"), memoryview(np.full(shape, 7.0))):
        call(make(), value)
        assert np.array_equal(np.asarray(value), wanted)
    assert (wide[..., 1::2] == 7.0).all()


@pytest.mark.parametrize("same", [True, False])
def test_values_of_the_call_count_not_those_of_the_call_before(same):
    first, second, torque = plant(), plant(), np.zeros((2, 2))
    for k in range(50):
        torque = torque if same else np.empty((2, 2))
        torque[:] = 0.01 * k
        first.step_with([torque, torque.tolist(), torque.astype("f4").astype(float), torque.T][0 if same else k % 2])
        second.step_with(np.full((2, 2), 0.01 * k))
        first.step_with(torque.tolist())
        second.step_with(torque.copy())
    assert np.array_equal(first.midpoint, second.midpoint) and np.array_equal(first.wheel_speeds, second.wheel_speeds)


def shortened(array):
    array.resize(2, refcheck=False)


def enlarged(array):
    array.resize(10**6, refcheck=False)


def fixed(array):
    array.flags.writeable = False


def reshaped(array):
    array.shape = (1, *array.shape)


def whole(array):
    array.dtype = "i8"


@outputs
@pytest.mark.parametrize("change", [shortened, enlarged, fixed, reshaped, whole])
def test_output_that_changes_between_calls_is_refused(case, change):
    make, call, shape = OUTPUTS[case]
    thing, out = make(), np.zeros(shape)
    call(thing, out)
    change(out)
    others = [np.zeros(shape) for _ in range(100)]
    before = out.copy()
    with pytest.raises(InputError) as refused:
        call(thing, out)
    assert refused.value.field.startswith(("out", "torque"))
    assert np.array_equal(out, before) and not np.any(others)


@pytest.mark.parametrize("change", [shortened, enlarged, reshaped])
def test_input_that_changes_between_calls_is_refused(change):
    thing, torque = plant(), np.ones((2, 2))
    thing.step_with(torque)
    change(torque)
    with pytest.raises(InputError) as refused:
        thing.step_with(torque)
    assert refused.value.field == "torque.shape"


def test_input_that_changes_its_type_between_calls_is_converted():
    first, second, torque = plant(), plant(), np.ones((2, 2))
    for thing in (first, second):
        thing.step_with(torque)
    torque.dtype = "i8"
    torque[:] = 2
    first.step_with(torque)
    second.step_with(np.full((2, 2), 2.0))
    assert np.array_equal(first.wheel_speeds, second.wheel_speeds)


def test_argument_that_uses_the_plant_itself_is_refused():
    thing = plant()

    class Argument:
        def __array__(self, dtype=None, copy=None):
            with pytest.raises(RunError, match="in progress"):
                thing.step_with(np.zeros((2, 2)))
            return np.zeros((2, 2))

    thing.step_with(Argument())
    assert thing.time_s == 0.001


NUMBERS = {
    "drive speed_m_s": ("speed_m_s", lambda v: robot().drive(v, 0.0)),
    "drive curvature": ("curvature", lambda v: robot().drive(0.0, v)),
    "curvature": ("steering_rad", CASCADE.curvature),
    "steering": ("curvature", CASCADE.steering),
    "steering rate": ("rate", lambda v: CASCADE.steering(0.0, v)),
    "references v": ("v", lambda v: CASCADE.references(AT, v, 0.0)),
    "references rate": ("steering_rate_rad_s", lambda v: CASCADE.references(AT, 0.0, 0.0, v)),
    "v_r": ("v_r", lambda v: LAW.command(AT, AT, v)),
    "kappa_r": ("kappa_r", lambda v: LAW.command(AT, AT, 0.0, v)),
}


@pytest.mark.parametrize("case", NUMBERS)
def test_number_is_checked(case):
    name, call = NUMBERS[case]
    for value in (np.float32(0.5), np.float64(0.5), 1, True):
        call(value)
    for value in (np.nan, np.inf, 1e300, -1e39):
        with pytest.raises(InputError) as refused:
            call(value)
        assert refused.value.field == name
    for value in (None, "1", 1j, [1.0], object()):
        with pytest.raises(TypeError):
            call(value)


SEEDS = {
    "run seed": ("seed", lambda v: run(S, v)),
    "run trial": ("trial", lambda v: run(S, 1, v)),
    "run_many seed": ("seed", lambda v: run_many(S, [v])),
    "run_many trial": ("trial", lambda v: run_many(S, [(1, v)])),
    "Plant seed": ("seed", lambda v: Plant(S, v)),
    "Plant trial": ("trial", lambda v: Plant(S, 1, v)),
    "Robot seed": ("seed", lambda v: Robot(S, v)),
    "Boards seed": ("seed", lambda v: Boards(S, v)),
    "drawn seed": ("seed", lambda v: cfmmr.drawn(S, v)),
    "drawn_plant trial": ("trial", lambda v: cfmmr.drawn_plant(S, 1, v)),
    "steps count": ("count", lambda v: plant().steps(v, np.zeros((2, 2)))),
}


@pytest.mark.parametrize("case", SEEDS)
def test_whole_number_is_checked(case):
    name, call = SEEDS[case]
    for value in (-1, 2**64, 10**30, 1.5, "1", 1j, np.float64(1), np.array([1, 2]), object()):
        with pytest.raises(InputError) as refused:
            call(value)
        assert refused.value.field == name and refused.value.allowed == f"a whole number from 0 to {2**64 - 1}"
    for value in (np.int64(3), np.uint8(3), True):
        call(value)


@pytest.mark.parametrize(
    "call, kinds",
    [
        (lambda: run(None, 1), TypeError),
        (lambda: run(S), TypeError),
        (lambda: run_many(S, 5), TypeError),
        (lambda: run_many([S, None], [1]), TypeError),
        (lambda: run_many(S, [(1, 2, 3)]), ValueError),
        (lambda: run_many(S, []), InputError),
        (lambda: run_many([], [1]), InputError),
        (lambda: run_many(S, cfmmr.trials(1, -5)), InputError),
        (lambda: run_many(S, [1], threads=0), InputError),
        (lambda: run_many(S, [1], threads=-1), InputError),
        (lambda: run_many(S, [1], threads=1.5), InputError),
        (lambda: run_many(S, [1], threads=10**30), InputError),
        (lambda: robot().follow([[0, 0], [1, 0]], 0), InputError),
        (lambda: robot().follow([[0, 0], [1, 0]], -1), InputError),
        (lambda: robot().follow([[0, 0], [1, 0]], 10**10), InputError),
        (lambda: robot().follow([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], 10**9), InputError),
        (lambda: robot().follow([[0, 0]]), InputError),
        (lambda: robot().follow([[0, 0], [0, 0]]), InputError),
        (lambda: plant().lift_wheel(2, 0), InputError),
        (lambda: plant().lift_wheel(0, 2), InputError),
        (lambda: plant().lift_wheel(-1, 0), InputError),
        (lambda: plant().snap_frame(1), InputError),
        (lambda: plant().snap_frame(1.0), InputError),
        (lambda: Scenario("nowhere"), InputError),
        (lambda: Scenario(5), TypeError),
        (lambda: Scenario(text="\0"), InputError),
        (lambda: Scenario(changes="plant.friction=1"), TypeError),
        (lambda: Scenario.load("/nowhere.toml"), InputError),
        (lambda: S.changed("plant.friction=nan"), InputError),
        (lambda: S.changed("plant.friction"), InputError),
        (lambda: S.rows("none"), InputError),
        (lambda: S["plant..friction"], KeyError),
        (lambda: S[5], TypeError),
        (lambda: cfmmr.keys("nowhere"), InputError),
        (lambda: cfmmr.keys(5), TypeError),
        (lambda: cfmmr.frame({}, "lists"), InputError),
        (lambda: intersection(criterion="none"), InputError),
        (lambda: intersection(a_covariance=-np.eye(3)), InputError),
        (lambda: intersection(a_covariance=[[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]), InputError),
        (lambda: algorithms.Ipec(S, [0, 0, 0], [0, 0, 1]), InputError),
        (lambda: ipec().step([0, 0, 0, 0], [0, 0, 0]), InputError),
        (lambda: FIT.fit([1.0] * 5), InputError),
        (lambda: algorithms.Fusion(S).step(front=5), TypeError),
        (lambda: axle_filter().step(left="fast"), TypeError),
        (lambda: boards(encoder=np.full((2, 2), 1e300)), InputError),
    ],
)
def test_other_wrong_arguments_are_refused(call, kinds):
    with pytest.raises(kinds) as refused:
        call()
    assert type(refused.value) is kinds and str(refused.value)


def test_refused_key_names_field_value_and_allowed_values():
    with pytest.raises(InputError) as refused:
        Scenario(changes=["plant.friction=-1"])
    error = refused.value
    assert (error.field, error.value, error.allowed) == ("plant.friction", "-1", "a number from 0 to 3")
    assert isinstance(error, ValueError) and InputError.field is None


def test_many_threads_for_one_trial():
    assert math.isfinite(run_many(S, [1], threads=10**9)["e_m"][0])


def test_new_path_replaces_the_path_of_a_task():
    thing = robot()
    for _ in range(3):
        thing.follow([[0, 0], [1, 0]])
    thing.follow([[0, 0], [1, 0]], timed=True)
    thing.regulate()
    thing.follow([[0, 0], [1, 0]])
