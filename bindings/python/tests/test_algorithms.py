"""Single algorithms against the paper's formulas in double precision."""

import numpy as np
import pytest

import cfmmr.algorithms as algorithms
from cfmmr import InputError, Scenario

RNG = np.random.default_rng(2024)


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def ahead(posture, by):
    """Posture `by` in the coordinates of `posture`."""
    c, s = np.cos(posture[2]), np.sin(posture[2])
    return np.array([posture[0] + c * by[0] - s * by[1], posture[1] + s * by[0] + c * by[1], posture[2] + by[2]])


def seen_from(posture, other):
    """`other` in the coordinates of `posture`."""
    d, c, s = other - posture, np.cos(posture[2]), np.sin(posture[2])
    return np.array([c * d[0] + s * d[1], c * d[1] - s * d[0], wrapped(d[2])])


def arc(curvature, length):
    """Displacement along a circular arc."""
    turn = curvature * length
    if abs(turn) < 1e-9:
        return np.array([length, 0.0, 0.0])
    return np.array([np.sin(turn) / curvature, (1 - np.cos(turn)) / curvature, turn])


def polar(posture, reference):
    """e, θ, α of the paper."""
    line = np.arctan2(*(reference - posture)[1::-1])
    return np.hypot(*(reference - posture)[:2]), wrapped(line - reference[2]), wrapped(line - posture[2])


def covariance(size, sigmas):
    mix = RNG.normal(size=(size, size)) * 0.3 + np.eye(size)
    return np.diag(sigmas) @ mix @ mix.T @ np.diag(sigmas)


@pytest.mark.parametrize("form", ["printed", "derived"])
@pytest.mark.parametrize("v_r, kappa_r", [(0.0, 0.0), (0.2, 0.7)])
def test_kinematic_law_is_equation_4(careful, form, v_r, kappa_r):
    table = "robot.lead.regulator.law"
    scenario = careful.changed(f"{table}.form={form}", f"{table}.denominator_floor=0")
    gains = scenario[table]
    r, k1, k2 = gains["circle_radius_m"], gains["approach_gain_m_s"], gains["heading_gain_rad_s"]
    postures = RNG.uniform([-2, -2, -0.5], [-0.3, 2, 0.5], size=(200, 3))
    reference = np.array([0.1, -0.2, 0.3])
    found = algorithms.KinematicLaw(scenario).command(postures, reference, v_r, kappa_r)
    compared = 0
    for posture, command in zip(postures, found):
        e, theta, alpha = polar(posture, reference)
        s = np.sqrt(1 + gains["epsilon"] - np.cos(2 * theta))
        bend = r * np.sqrt(2) * np.sin(2 * theta)
        below = e * s * (np.cos(alpha) if form == "derived" else 1) + bend * np.sin(alpha)
        if abs(below) < 0.05:
            continue
        above = k1 * e * s * np.tanh(e - r * np.sqrt(2) * s)
        above += v_r * (e * s * np.cos(theta) + bend * (np.sin(theta) + kappa_r * e))
        v = above / below
        yaw_rate = k2 * np.tanh(theta + alpha) + 2 / e * (v * np.sin(alpha) - v_r * np.sin(theta)) - v_r * kappa_r
        assert command[[0, 2]] == pytest.approx([v, yaw_rate], rel=2e-4, abs=2e-5)
        assert command[1] * command[0] == pytest.approx(command[2], rel=1e-5)
        compared += 1
    assert compared > 150


def test_kinematic_law_takes_one_posture_or_many(careful):
    law = algorithms.KinematicLaw(careful)
    postures = RNG.uniform(-1, 1, size=(5, 3))
    many = law.command(postures, [0, 0, 0])
    assert np.array_equal(many, [law.command(posture, [0, 0, 0]) for posture in postures])
    assert law.command(np.empty((0, 3)), [0, 0, 0]).shape == (0, 3)


@pytest.mark.parametrize("rigid_end", [0.0, 0.03])
def test_cascade_follows_the_geometry_of_the_arc(careful, rigid_end):
    scenario = careful.changed(f"robot.geometry.rigid_end_m={rigid_end}")
    cascade, length = algorithms.Cascade(scenario), scenario["robot.geometry.frame_length_m"]
    chord = lambda psi: length * np.sinc(psi / np.pi) + 2 * rigid_end * np.cos(psi)  # noqa: E731
    for psi, rate, v in RNG.uniform([-0.45, -1, -0.3], [0.45, 1, 0.3], size=(50, 3)):
        kappa = 2 * np.tan(psi) / chord(psi)
        assert cascade.curvature(psi) == pytest.approx(kappa, rel=1e-5)
        slope = (2 * np.tan(psi + 1e-5) / chord(psi + 1e-5) - 2 * np.tan(psi - 1e-5) / chord(psi - 1e-5)) / 2e-5
        assert cascade.steering(kappa, 0.5) == pytest.approx([psi, 0.5 / slope], rel=1e-4, abs=1e-6)
        midpoint = RNG.uniform(-1, 1, size=3)
        postures, twists = cascade.references(midpoint, v, psi, rate)
        parting = (chord(psi + 1e-5) - chord(psi - 1e-5)) / 2e-5 * rate / 2
        for sign, posture, twist in zip((1, -1), postures, twists):
            assert posture == pytest.approx(ahead(midpoint, [sign * chord(psi) / 2, 0, sign * psi]), abs=1e-6)
            wanted = [(v + sign * parting) / np.cos(psi), v * kappa + sign * rate]
            assert twist == pytest.approx(wanted, rel=1e-4, abs=1e-6)


def test_printed_cascade_is_equations_5_and_6(careful):
    scenario = careful.changed("robot.lead.cascade.form=printed", "robot.geometry.rigid_end_m=0")
    cascade, length = algorithms.Cascade(scenario), scenario["robot.geometry.frame_length_m"]
    for psi, rate, v in RNG.uniform([-0.45, -1, -0.3], [0.45, 1, 0.3], size=(50, 3)):
        kappa = 2 * psi / (length * np.cos(psi))
        assert cascade.curvature(psi) == pytest.approx(kappa, rel=1e-5)
        _, twists = cascade.references([0, 0, 0], v, psi, rate)
        for sign, twist in zip((1, -1), twists):
            wanted = [v / np.cos(psi) - sign * length * psi * rate / 6, v * kappa + sign * rate]
            assert twist == pytest.approx(wanted, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("criterion", ["determinant", "trace"])
def test_covariance_intersection_minimises_over_omega(criterion):
    size = np.linalg.det if criterion == "determinant" else lambda p: np.trace(np.diag([1, 1, 0.2**2]) @ p)
    for _ in range(30):
        a, b = RNG.normal(size=3) * 0.1, RNG.normal(size=3) * 0.1
        pa, pb = covariance(3, [0.02, 0.1, 0.03]), covariance(3, [0.1, 0.02, 0.05])
        inverses = np.linalg.inv(pa), np.linalg.inv(pb)
        fused = lambda w: np.linalg.inv(w * inverses[0] + (1 - w) * inverses[1])  # noqa: E731,B023
        low, high = 0.0, 1.0
        for _ in range(100):
            first, second = low + 0.4 * (high - low), low + 0.6 * (high - low)
            low, high = (low, second) if size(fused(first)) < size(fused(second)) else (first, high)
        p = fused(low)
        omega, posture, found = algorithms.covariance_intersection(a, pa, b, pb, criterion)
        assert omega == pytest.approx(low, abs=1e-3)
        assert found == pytest.approx(p, rel=1e-3, abs=1e-3 * np.trace(p))
        wanted = p @ (low * inverses[0] @ a + (1 - low) * inverses[1] @ b)
        assert posture == pytest.approx(wanted, abs=3e-4)


def test_covariance_intersection_of_equal_inputs_is_the_input():
    p = covariance(3, [0.1, 0.1, 0.1])
    omega, posture, found = algorithms.covariance_intersection([1, 2, 0.5], p, [1, 2, 0.5], p)
    assert omega == 0.5 and posture == pytest.approx([1, 2, 0.5]) and found == pytest.approx(p, rel=1e-5)


def test_ipec_is_the_geometry_of_both_axles(careful):
    track = 2 * careful["robot.geometry.half_track_m"]
    axles = [np.array([0.2, 0.1, 0.3]), np.array([-0.15, 0.0, 0.2])]
    config, variance = careful["robot.lead.fusion.ipec"], 0.0

    def growth(advance, relative):
        """Growth of the variance of the line's direction."""
        (ds1, ds2), baseline = advance.reshape(2, 2).mean(axis=1), np.hypot(*relative[:2])
        alpha = np.arctan2(relative[1], relative[0])
        g1, g2 = -alpha, relative[2] - alpha
        wheels = (np.sin(g1) ** 2 + np.sin(g2) ** 2) * config["wheel_sigma_m"] ** 2 / 2
        heading = (ds2 * np.cos(g2) * config["heading_sigma_rad"]) ** 2
        side = ((ds1 * np.cos(g1) - ds2 * np.cos(g2)) * config["lateral_sigma_m"] / baseline) ** 2
        return (wheels + heading + side) / baseline**2

    ipec = algorithms.Ipec(careful, *axles)
    for _ in range(200):
        advance = RNG.normal(0.002, 0.0005, size=4)
        relative = np.array([-0.36, 0.01, -0.05]) + RNG.normal(size=3) * [1e-3, 1e-3, 5e-3]
        for axle, (left, right) in zip(axles, advance.reshape(2, 2)):
            turn = (right - left) / track
            axle += np.array(
                [*((left + right) / 2 * np.array([np.cos(axle[2] + turn / 2), np.sin(axle[2] + turn / 2)])), turn]
            )
        line = axles[1][:2] - axles[0][:2]
        first = np.arctan2(line[1], line[0]) - np.arctan2(relative[1], relative[0])
        wanted = [wrapped(first - axles[0][2]), wrapped(first + relative[2] - axles[1][2])]
        axles[0][2], axles[1][2] = wrapped(first), wrapped(first + relative[2])
        slide = 0.5 * (np.hypot(*relative[:2]) - np.hypot(*line)) * line / np.hypot(*line)
        axles[0][:2] -= slide
        axles[1][:2] += slide
        assert ipec.step(advance, relative) == pytest.approx(wanted, abs=2e-6)
        variance += growth(advance, relative)
        assert ipec.postures == pytest.approx(np.array(axles), abs=2e-5)
    assert seen_from(*ipec.postures) == pytest.approx(relative, abs=2e-6)
    assert ipec.variance == pytest.approx(variance, rel=1e-4)


class PlainFilter:
    """Extended Kalman filter of seven states in its textbook form, without gates."""

    def __init__(self, scenario, state, p):
        self.x, self.p = np.array(state, float), np.array(p, float)
        self.config, self.h = scenario["robot.axle.filter"], scenario["robot.geometry.half_track_m"]

    def step(self, left, right, gyro, acceleration, t=1e-3):
        x, noise = self.x, self.config["noise"]
        ds, turn = x[3] * t + x[5] * t * t / 2, x[4] * t + x[6] * t * t / 2
        c, s = np.cos(x[2] + turn / 2), np.sin(x[2] + turn / 2)
        a = np.eye(7)
        along, around = np.array([t, t * t / 2]), np.array([t, t * t / 2])
        a[0, [2, 3, 5]], a[0, [4, 6]] = [-ds * s, *(along * c)], -ds * s / 2 * around
        a[1, [2, 3, 5]], a[1, [4, 6]] = [ds * c, *(along * s)], ds * c / 2 * around
        a[2, [4, 6]], a[3, 5], a[4, 6] = around, t, t
        self.x = x + [ds * c, ds * s, turn, x[5] * t, x[6] * t, 0, 0]
        q = np.zeros((7, 7))
        slip = [
            noise[f"{way}_m_per_sqrt_m"] ** 2 * abs(ds) + noise[f"{way}_m_per_sqrt_s"] ** 2 * t
            for way in ("along", "across")
        ]
        turned = np.array([[c, -s], [s, c]])
        q[:2, :2] = turned @ np.diag(slip) @ turned.T
        q[2, 2] = noise["heading_rad_per_sqrt_m"] ** 2 * abs(ds) + noise["heading_rad_per_sqrt_s"] ** 2 * t
        for rate, change, density in (
            (3, 5, noise["jerk_m_s3_per_sqrt_hz"]),
            (4, 6, noise["yaw_jerk_rad_s3_per_sqrt_hz"]),
        ):
            g = np.zeros(7)
            g[rate], g[change] = t / 2, 1
            q += density**2 * t * np.outer(g, g)
        self.p = a @ self.p @ a.T + q
        rows = [
            (left, {3: 1, 4: -self.h}, self.config["left_sigma_m_s"]),
            (right, {3: 1, 4: self.h}, self.config["right_sigma_m_s"]),
            (gyro, {4: 1}, self.config["gyro_sigma_rad_s"]),
            (acceleration, {5: 1}, self.config["accelerometer_sigma_m_s2"]),
        ]
        for measured, entries, sigma in rows:
            if measured is not None:
                h = np.zeros(7)
                h[list(entries)] = list(entries.values())
                self.update(h[None], [measured - h @ self.x], [[sigma**2]])

    def update(self, h, innovation, r):
        gain = self.p @ h.T @ np.linalg.inv(h @ self.p @ h.T + r)
        self.x, self.p = self.x + gain @ innovation, (np.eye(7) - gain @ h) @ self.p


@pytest.mark.parametrize("missing", [(), ("gyro",), ("gyro", "acceleration"), ("left",)])
def test_axle_filter_is_the_plain_filter(careful, missing):
    scenario = careful.changed("robot.axle.filter.innovation_gate=1e6")
    start = np.diag([1e-4, 2e-4, 1e-4, 1e-3, 1e-3, 1e-2, 1e-1])
    state = [0.3, -0.2, 0.5, 0, 0, 0, 0]
    found, plain = algorithms.AxleFilter(scenario, state, start), PlainFilter(scenario, state, start)
    h = scenario["robot.geometry.half_track_m"]
    for tick in range(2000):
        v, yaw_rate = 0.2 * np.tanh(tick / 300), 0.5 * np.sin(tick / 400)
        truth = {"left": v - h * yaw_rate, "right": v + h * yaw_rate, "gyro": yaw_rate, "acceleration": 0.0}
        noise = dict(zip(truth, RNG.normal(size=4) * [0.02, 0.02, 0.005, 0.5]))
        measured = {name: None if name in missing else float(np.float32(truth[name] + noise[name])) for name in truth}
        verdicts = found.step(**measured)
        plain.step(**measured)
    assert verdicts == ["absent" if name in missing else "used" for name in truth]
    sigmas = np.sqrt(np.diag(plain.p))
    assert (np.abs(found.state - plain.x) <= 0.02 * sigmas + 2e-5).all()
    scale = np.outer(sigmas, sigmas)
    assert found.covariance / scale == pytest.approx(plain.p / scale, abs=5e-3)


def test_axle_filter_takes_a_posture_as_the_plain_filter(careful):
    start = np.diag([1e-2, 2e-2, 1e-2, 1e-3, 1e-3, 1e-2, 1e-1])
    state = [0.3, -0.2, 0.5, 0.1, 0.2, 0, 0]
    found, plain = algorithms.AxleFilter(careful, state, start), PlainFilter(careful, state, start)
    for _ in range(100):
        measured = [0.08, 0.12, 0.2, 0.0]
        found.step(*measured)
        plain.step(*measured)
    posture, r = plain.x[:3] + [0.05, -0.04, 0.02], covariance(3, [0.05, 0.05, 0.05])
    assert found.update_posture(posture, r) == "used"
    plain.update(np.eye(3, 7), posture - plain.x[:3], r)
    sigmas = np.sqrt(np.diag(plain.p))
    assert (np.abs(found.state - plain.x) <= 0.01 * sigmas + 1e-5).all()
    assert found.covariance / np.outer(sigmas, sigmas) == pytest.approx(plain.p / np.outer(sigmas, sigmas), abs=5e-3)


@pytest.mark.parametrize("bad, verdict", [(np.nan, "invalid"), (np.inf, "invalid"), (1e300, "invalid"), (5.0, "gated")])
def test_axle_filter_leaves_out_a_bad_sample(careful, bad, verdict):
    found, without = algorithms.AxleFilter(careful), algorithms.AxleFilter(careful)
    assert found.step(0.0, 0.0, bad, 0.0) == ["used", "used", verdict, "used"]
    assert without.step(0.0, 0.0, None, 0.0) == ["used", "used", "absent", "used"]
    assert np.array_equal(found.state, without.state) and np.array_equal(found.covariance, without.covariance)


@pytest.mark.parametrize("rigid_end", [0.0, 0.03])
@pytest.mark.parametrize("method", ["piecewise", "quadrature", "elastica"])
def test_constant_curvature_fits_a_circular_arc(careful, method, rigid_end):
    scenario = careful.changed(f"robot.beam.method={method}", f"robot.geometry.rigid_end_m={rigid_end}")
    fit, geometry = algorithms.StrainFit(scenario), scenario["robot.geometry"]
    curvatures = np.linspace(-3, 3, 13)
    strains = np.outer(curvatures * geometry["half_thickness_m"], np.ones(fit.gauges))
    ends = [np.array([rigid_end, 0, 0]), arc(0, rigid_end)]
    wanted = [ahead(ahead(ends[0], arc(k, geometry["frame_length_m"])), ends[1]) for k in curvatures]
    assert fit.postures(strains) == pytest.approx(np.array(wanted), abs=2e-5)
    result = fit.fit(strains[3])
    assert result["method"] == method and result["posture"] == pytest.approx(wanted[3], abs=2e-5)
    assert np.linalg.eigvalsh(result["covariance"]).min() > 0
    if method == "elastica":
        moment = geometry["bending_stiffness_n_m2"] * curvatures[3]
        assert result["wrench"] == pytest.approx([0, 0, moment, moment], abs=5e-3 * abs(moment))


def test_linear_curvature_fits_a_clothoid(careful):
    scenario = careful.changed("robot.beam.method=quadrature")
    fit, geometry = algorithms.StrainFit(scenario), scenario["robot.geometry"]
    length, gauges = geometry["frame_length_m"], np.array(scenario["robot.beam.strip.gauges_m"])
    k0, k1 = 0.5, 2.0
    s = np.linspace(0, length, 20_001)
    phi = k0 * s + k1 * s**2 / (2 * length)
    wanted = [np.trapezoid(np.cos(phi), s), np.trapezoid(np.sin(phi), s), phi[-1]]
    strain = geometry["half_thickness_m"] * (k0 + k1 * gauges / length)
    assert fit.fit(strain)["posture"] == pytest.approx(wanted, abs=2e-5)


def test_segments_of_a_plan_end_in_the_funnel(careful):
    config, planner = careful["robot.lead.regulator.planner"], algorithms.Planner(careful)
    kappa = config["curvature_share"] * algorithms.Cascade(careful).max_curvature
    found = 0
    for posture in RNG.uniform([-2, -2, -np.pi], [2, 2, np.pi], size=(100, 3)):
        goal = RNG.uniform([-0.5, -0.5, -np.pi], [0.5, 0.5, np.pi])
        plan = planner.plan(posture, goal)
        if plan is None:
            continue
        found += 1
        end = posture
        assert len(plan["segments"]) <= 2
        for direction, curvature, length in plan["segments"]:
            sign = {"forward": 1, "reverse": -1}[direction]
            assert abs(curvature) <= kappa * 1.001 and length > 0
            end = ahead(end, arc(curvature, sign * length))
        turn = 0.0 if plan["approach"] == "forward" else np.pi
        e, theta, alpha = polar(end, goal)
        theta, alpha = wrapped(theta + turn), wrapped(alpha + turn)
        eta = wrapped(theta + alpha)
        assert 2 * abs(np.sin(alpha)) + 3 * abs(eta) <= kappa * e + 1e-3
        assert abs(alpha) + (abs(eta) if alpha * eta < 0 else 0) <= 2.4 + 1e-3
        assert e >= config["min_approach_m"] - 1e-4
        driven = sum(length for *_, length in plan["segments"])
        assert plan["cost_m"] >= driven + e - 1e-4
    assert found > 90


def test_plan_for_a_robot_in_the_funnel_has_no_segments(careful):
    plan = algorithms.Planner(careful).plan([-0.5, 0, 0], [0, 0, 0])
    assert plan == {"segments": [], "approach": "forward", "cost_m": pytest.approx(0.5)}


def law(scenario, posture, twist, reference, reference_twist, acceleration, load):
    """Equations 7 to 10 with feedforward, before the limit of torque."""
    c, g = scenario["robot.axle.controller"], scenario["robot.geometry"]
    r, d = g["wheel_radius_m"], g["half_track_m"]
    error = seen_from(posture, reference)
    v_r, w_r = reference_twist
    speed = max(abs(v_r), c["heading_speed_floor_m_s"])
    command = np.array(
        [
            v_r * np.cos(error[2]) + c["longitudinal_gain_per_s"] * error[0],
            w_r + c["lateral_gain_rad_m2"] * v_r * error[1] + c["heading_gain_rad_m"] * speed * np.sin(error[2]),
        ]
    )
    squares = [command, twist, reference_twist, acceleration, [np.dot(twist, twist)], [1], load]
    xi = min(sum(np.dot(part, part) for part in squares), c["max_xi_squared"])
    wheel = 2 * c["wheel_inertia_kg_m2"] / r**2
    inertia = np.array([c["mass_kg"] + wheel, c["yaw_inertia_kg_m2"] + wheel * d**2])
    gains = np.array([c["velocity_gain_n_s_m"], c["yaw_rate_gain_nm_s_rad"]])
    force, moment = inertia * acceleration - gains * (twist - command) * xi - np.array([load[0], load[2]])
    return r / 2 * np.array([force - moment / d, force + moment / d])


def test_dynamic_law_is_equations_7_to_10(careful):
    found = algorithms.DynamicLaw(careful)
    for _ in range(100):
        posture = RNG.uniform(-1, 1, size=3)
        reference = posture + RNG.normal(size=3) * [2e-3, 2e-3, 1e-2]
        twist, reference_twist = RNG.normal(size=(2, 2)) * 0.02 + [0.1, 0.2]
        acceleration, load = RNG.normal(size=2) * 0.1, RNG.normal(size=3) * [0.3, 0.3, 0.05]
        arguments = (posture, twist, reference, reference_twist, acceleration, load)
        assert found.torques(*arguments) == pytest.approx(law(careful, *arguments), rel=1e-3, abs=2e-4)


def test_dynamic_law_without_error_feeds_the_load_forward(careful):
    found, geometry = algorithms.DynamicLaw(careful), careful["robot.geometry"]
    at = [0.3, -0.2, 0.4]
    assert found.torques(at, [0, 0], at, [0, 0]) == [0, 0]
    force, moment = 2.0, 0.1
    half, d = geometry["wheel_radius_m"] / 2, geometry["half_track_m"]
    wanted = [-half * (force - moment / d), -half * (force + moment / d)]
    assert found.torques(at, [0, 0], at, [0, 0], load=[force, 5.0, moment]) == pytest.approx(wanted, rel=1e-5)


def test_torques_beyond_the_limit_keep_their_ratio(careful):
    found, limit = algorithms.DynamicLaw(careful), careful["robot.axle.controller.max_torque_nm"]
    arguments = ([0, 0, 0], [0, 0], [0.5, 0, 0.1], [0.2, 0], [0, 0], [0, 0, 0])
    wanted = law(careful, *map(np.array, arguments))
    torques = np.array(found.torques(*arguments))
    assert np.abs(torques).max() == pytest.approx(limit) and np.abs(wanted).max() > limit
    assert torques[0] / torques[1] == pytest.approx(wanted[0] / wanted[1], rel=1e-4)


def test_fusion_without_beam_is_odometry(careful):
    scenario = careful.changed("robot.lead.fusion.mode=odometry")
    length = scenario["robot.geometry.frame_length_m"]
    middle = np.array([0.1, 0.2, 0.3])
    fusion = algorithms.Fusion(scenario, middle, 1e-6 * np.eye(3))
    assert fusion.robot[0] == pytest.approx(middle, abs=1e-6)
    axles = [ahead(middle, [sign * length / 2, 0, 0]) for sign in (1, -1)]
    by, small = np.array([0.002, 0.0, 0.001]), 1e-9 * np.eye(3)
    for _ in range(100):
        assert fusion.step((by, small), (by, small)) == "absent"
        axles = [ahead(axle, by) for axle in axles]
    assert fusion.front[0] == pytest.approx(axles[0], abs=1e-5)
    assert fusion.rear[0] == pytest.approx(axles[1], abs=1e-5)
    assert fusion.robot[0][:2] == pytest.approx((axles[0] + axles[1])[:2] / 2, abs=2e-5)


def test_joint_fusion_lets_the_beam_correct_the_headings(careful):
    fusion = algorithms.Fusion(careful)
    length = careful["robot.geometry.frame_length_m"]
    small, beam = 1e-8 * np.eye(3), ([length, 0, 0], 1e-8 * np.eye(3))
    verdicts = {fusion.step(([0.002, 0, 1e-4], 1e-6 * np.eye(3)), ([0.002, 0, 0], small), beam) for _ in range(100)}
    relative = seen_from(fusion.rear[0], fusion.front[0])
    assert verdicts == {"used"} and relative == pytest.approx([length, 0, 0], abs=2e-3)


def test_parameters_of_the_scenario_are_used(careful):
    slow = careful.changed("robot.lead.regulator.law.approach_gain_m_s=0.75")
    first, second = (algorithms.KinematicLaw(s).command([-1, 0.2, 0], [0, 0, 0])[0] for s in (careful, slow))
    assert second == pytest.approx(first / 2, rel=1e-5)


def test_refused_parameter_is_named():
    with pytest.raises(InputError) as refused:
        algorithms.KinematicLaw(Scenario(changes=["robot.lead.regulator.law.epsilon=-1"]))
    assert refused.value.field == "robot.lead.regulator.law.epsilon"
