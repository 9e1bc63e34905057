"""The drawn robot in MuJoCo, in place of the simulated plant."""

from __future__ import annotations

from functools import partial
from typing import Any

import mujoco
import numpy as np

from ..runs import drawn_plant
from .._native import Scenario
from .grounds import FLAT, Ground

HINGES = 20
"""Number of elastic hinges in a frame."""
_TWIST_EVERY = 4
"""Every fourth hinge twists too."""
_POISSON = 0.3
_DENSITY, _YOUNG = 7850.0, 2.05e11
"""Density (kg/m³) and modulus of elasticity (Pa) of the steel strip."""
_HINGE_INERTIA = 1e-4
"""Rotor inertia of a hinge, kg m²: keeps explicit integration stable, and adds 5e-6 kg m² to the bending of a frame."""
_WHEEL_HALF_WIDTH_M = 0.02
_SENSORS = {"gyro": mujoco.mjtSensor.mjSENS_GYRO, "accelerometer": mujoco.mjtSensor.mjSENS_ACCELEROMETER}
_SETTLE_TICKS = 1000
_HELD = 1e3
"""Damping of a held wheel, N m s/rad."""
_PITCH_DAMPING = 0.02
"""Damping of the hinge between a frame and an inner axle ahead of it, N m s/rad."""
_CONTACT_TIME_S = 0.003
"""Time constant of a contact's compliance: a wheel sinks in by 0.1 mm."""


class MuJoCoRobot:
    """The robot that is drawn for a seed and a trial, simulated by MuJoCo.

    Has the methods and properties of `Plant` that `run` needs. Rigid axles and wheels in three dimensions; each frame is
    a chain of `HINGES` hinges that bend and twist. An inner axle can pitch against the frame behind it. Contacts have
    Coulomb friction. Backlash, side slip, floor drift and load-dependent radii of the drawn robot are left out.

    ground: in a square from −reach_m to reach_m; the robot falls off its edge. impratio: stiffness of friction over that
    of the normal force in MuJoCo's contacts.

    The wheels are held until the mission's time to settle has passed, so that the robot does not roll down a slope.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int,
        trial: int = 0,
        ground: Ground = FLAT,
        *,
        reach_m: float = 8.0,
        impratio: float = 10.0,
    ):
        drawn = drawn_plant(scenario, seed, trial)
        self._plant = drawn["plant"]
        random = np.random.default_rng([seed, trial])
        self.model = model_of(drawn, ground, reach_m, impratio, random)
        self.data = mujoco.MjData(self.model)
        named = partial(mujoco.mj_name2id, self.model)
        bodies, joints = mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_JOINT
        axles = len(self._plant["mass_kg"])
        self._axles = [named(bodies, f"axle{axle}") for axle in range(axles)]
        names = [f"wheel{axle}.{side}" for axle in range(axles) for side in range(2)]
        wheels = [named(joints, name) for name in names]
        self._motors = [named(mujoco.mjtObj.mjOBJ_ACTUATOR, name) for name in names]
        sensors = [[named(mujoco.mjtObj.mjOBJ_SENSOR, f"{kind}{axle}") for axle in range(axles)] for kind in _SENSORS]
        gyros, accelerometers = self.model.sensor_adr[np.array(sensors)]
        self._yaw_rates, self._forward = gyros + 2, accelerometers
        self._wheel_angles = self.model.jnt_qposadr[wheels]
        self._wheel_rates = self.model.jnt_dofadr[wheels]
        bends = [[named(joints, f"bend{frame}.{k}") for k in range(HINGES)] for frame in range(axles - 1)]
        self._bends = self.model.jnt_qposadr[np.array(bends)]
        self._strain = [
            drawn["half_thickness_m"] * _interpolation(gauges, self._plant["strip_length_m"])
            for gauges in drawn["gauges_m"]
        ]
        self._held_until_s = scenario["mission.settle_s"]
        self._hold(True)
        mujoco.mj_step(self.model, self.data, _SETTLE_TICKS)
        self.data.time = 0.0
        self._zero = self.data.qpos[self._wheel_angles].copy()
        mujoco.mj_forward(self.model, self.data)

    def _hold(self, held: bool) -> None:
        self._held = held
        self.model.dof_damping[self._wheel_rates] = _HELD if held else 0.0

    def sensed_into(self, out: np.ndarray) -> None:
        """Writes the sensed values in the order of `Robot.sensed_names`."""
        data, axles = self.data, len(self._axles)
        per_axle = out[: 4 * axles].reshape(axles, 4)
        per_axle[:, :2] = (data.qpos[self._wheel_angles] - self._zero).reshape(axles, 2)
        per_axle[:, 2] = data.sensordata[self._yaw_rates]
        per_axle[:, 3] = data.sensordata[self._forward]
        begin = 4 * axles
        for strain, angles in zip(self._strain, self._bends):
            out[begin : begin + len(strain)] = strain @ data.qpos[angles]
            begin += len(strain)

    def step_with(self, torque: np.ndarray) -> None:
        """Advances by 1 ms with wheel torques, shape (axles, 2): left and right, N m."""
        if self._held and self.data.time >= self._held_until_s:
            self._hold(False)
        plant = self._plant
        share = self.data.qvel[self._wheel_rates] / plant["no_load_speed_rad_s"]
        stall, most = plant["stall_torque_n_m"], plant["torque_limit_n_m"]
        least, most = np.maximum(-stall * (1 + share), -most), np.minimum(stall * (1 - share), most)
        self.data.ctrl[self._motors] = np.clip(np.ravel(torque), least, most)
        mujoco.mj_step(self.model, self.data)

    @property
    def axles(self) -> np.ndarray:
        """Postures of the axles on the map, shape (axles, 3): m, m, rad."""
        places = self.data.xpos[self._axles]
        forward = self.data.xmat[self._axles].reshape(-1, 3, 3)[:, :, 0]
        return np.column_stack([places[:, :2], np.arctan2(forward[:, 1], forward[:, 0])])

    @property
    def midpoint(self) -> np.ndarray:
        """Posture of the midpoint on the map, shape (3,): m, m, rad; its heading is from the last axle to the first."""
        places = self.axles[:, :2]
        middles = 0.5 * (places[:-1] + places[1:])
        dx, dy = places[0] - places[-1]
        return np.array([*middles.mean(axis=0), np.arctan2(dy, dx)])

    @property
    def wheel_speeds(self) -> np.ndarray:
        """Wheel speeds, shape (axles, 2): left and right, rad/s."""
        return self.data.qvel[self._wheel_rates].reshape(-1, 2)

    @property
    def torques(self) -> np.ndarray:
        """Wheel torques, shape (axles, 2): left and right, N m."""
        return self.data.ctrl[self._motors].reshape(-1, 2)

    @property
    def relative(self) -> np.ndarray:
        """Posture of each axle in the coordinates of the axle behind it, on the map, shape (frames, 3): m, m, rad."""
        axles = self.axles
        ahead, behind = axles[:-1], axles[1:]
        dx, dy, turn = (ahead - behind).T
        sin, cos = np.sin(behind[:, 2]), np.cos(behind[:, 2])
        turn -= 2 * np.pi * np.round(turn / (2 * np.pi))
        return np.column_stack([cos * dx + sin * dy, cos * dy - sin * dx, turn])


def maker(ground: Ground | str = "flat", **options: Any) -> partial[MuJoCoRobot]:
    """Function for the argument `plant` of `run`, `run_path` and `run_many`."""
    ground = Ground.parse(ground) if isinstance(ground, str) else ground
    return partial(MuJoCoRobot, ground=ground, **options)


def _interpolation(gauges: list[float], length: float) -> np.ndarray:
    """Matrix from the hinges' angles to the curvature at the gauges, 1/m: cubic through the four nearest hinges."""
    step = length / HINGES
    places = (np.arange(HINGES) + 0.5) * step
    matrix = np.zeros((len(gauges), HINGES))
    for row, gauge in zip(matrix, gauges):
        first = int(np.clip(np.round(gauge / step) - 2, 0, HINGES - 4))
        near = places[first : first + 4]
        for k in range(4):
            others = np.delete(near, k)
            row[first + k] = np.prod((gauge - others) / (near[k] - others)) / step
    return matrix


def model_of(
    drawn: dict[str, Any], ground: Ground, half_size_m: float, impratio: float, random: np.random.Generator
) -> mujoco.MjModel:
    """Model of the drawn robot on a ground."""
    plant = drawn["plant"]
    spec = mujoco.MjSpec()
    spec.compiler.balanceinertia = True
    spec.compiler.autolimits = True
    option = spec.option
    option.timestep = 1e-3
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = impratio
    slope, downhill = plant["slope_rad"], plant["downhill_rad"]
    sin = np.sin(slope)
    option.gravity = 9.81 * np.array([sin * np.cos(downhill), sin * np.sin(downhill), -np.cos(slope)])
    contact = spec.default.geom
    contact.friction = [plant["friction"], 0, 0]
    contact.condim = 3
    contact.solref = [_CONTACT_TIME_S, 1]
    _add_looks(spec)
    contact.material = "floor"
    height = ground.build(spec, half_size_m, random)
    contact.material = ""

    axles = len(plant["mass_kg"])
    x, y, heading = drawn["start"]
    span = plant["strip_length_m"] + plant["rigid_root_m"] + plant["rigid_tip_m"]
    behind = 0.5 * (axles - 1) * span
    along = np.array([np.cos(heading), np.sin(heading)])
    rear = np.array([x, y]) - behind * along
    # Lowered from above the highest ground below the robot.
    below = max(height(*(rear + share * behind * along + across * np.array([-along[1], along[0]])))
                for share in np.linspace(-0.5, 2.5, 31) for across in (-0.2, 0.0, 0.2))
    body = spec.worldbody.add_body(
        pos=[*rear, below + np.max(plant["wheel_radius_m"][-1]) + 1e-3],
        quat=[np.cos(heading / 2), 0, 0, np.sin(heading / 2)],
    )
    body.add_freejoint()
    _add_axle(spec, body, plant, axles - 1)
    for frame in range(axles - 2, -1, -1):
        body = _add_frame(body, plant, frame, 2 * drawn["half_thickness_m"])
        _add_axle(spec, body, plant, frame)
    return spec.compile()


def _add_looks(spec: mujoco.MjSpec) -> None:
    """Light and the floor's pattern, of squares of 0.25 m."""
    spec.visual.quality.shadowsize = 1024
    spec.visual.quality.offsamples = 2
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.3, 0.3, 0.3]
    light = spec.worldbody.add_light(pos=[0, 0, 4], dir=[0.3, 0.2, -1], castshadow=True)
    light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    light.diffuse = [0.7, 0.7, 0.7]
    kinds = mujoco.mjtTexture
    spec.add_texture(
        name="floor", type=kinds.mjTEXTURE_2D, builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER, width=256, height=256,
        rgb1=[0.62, 0.63, 0.65], rgb2=[0.7, 0.71, 0.73],
    )
    spec.add_texture(
        name="sky", type=kinds.mjTEXTURE_SKYBOX, builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, width=64, height=64,
        rgb1=[0.9, 0.93, 0.97], rgb2=[0.75, 0.8, 0.88],
    )
    material = spec.add_material(name="floor", texrepeat=[2, 2], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"


def _add_axle(spec: mujoco.MjSpec, body: mujoco.MjsBody, plant: dict[str, Any], axle: int) -> None:
    """Mass, wheels, motors and sensors of an axle. The body's origin is the middle of the wheels' axis."""
    last = axle == len(plant["mass_kg"]) - 1
    mass = plant["mass_kg"][axle] + plant["payload_kg"][axle] + (plant["sensing_mass_kg"] if axle > 0 else 0.0)
    radii, half_track = plant["wheel_radius_m"][axle], plant["half_track_m"][axle]
    yaw = plant["yaw_inertia_kg_m2"][axle]
    # A wheel is a ring; its mass is limited so that the body keeps part of the axle's yaw inertia.
    spin = plant["wheel_inertia_kg_m2"] * (1 - plant["rotor_inertia_share"])
    ring = min(spin / np.mean(radii) ** 2, 0.25 * yaw / half_track**2)
    own = mass - 2 * ring
    own_yaw = yaw - 2 * ring * half_track**2 - spin
    above = (mass * (plant["center_of_mass_height_m"] - np.mean(radii))) / own
    body.name = f"axle{axle}"
    body.mass = own
    body.ipos = [0, 0, above]
    body.inertia = [own_yaw, 0.3 * own_yaw, own_yaw]
    body.explicitinertial = True
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.04, 0.9 * half_track, 0.025], pos=[0, 0, above],
        contype=0, conaffinity=0, mass=0, rgba=[0.25, 0.45, 0.7, 1] if not last else [0.7, 0.45, 0.25, 1],
    )
    body.add_site(name=f"axle{axle}")
    # Resistance to rolling as friction of the bearing under half of the weight.
    for side, (radius, place) in enumerate(zip(radii, (half_track, -half_track))):
        wheel = body.add_body(name=f"wheel{axle}.{side}", pos=[0, place, 0])
        wheel.mass = ring
        wheel.inertia = [0.5 * spin, spin, 0.5 * spin]
        wheel.explicitinertial = True
        wheel.add_joint(
            name=f"wheel{axle}.{side}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0],
            armature=plant["wheel_inertia_kg_m2"] - spin,
            frictionloss=plant["rolling_resistance"] * 0.5 * mass * 9.81 * radius,
        )
        # An ellipsoid, a tyre with a crown: one contact below the middle of the wheel.
        wheel.add_geom(
            type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=[radius, _WHEEL_HALF_WIDTH_M, radius], mass=0,
            rgba=[0.15, 0.15, 0.15, 1],
        )
        wheel.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.8 * radius, 1.05 * _WHEEL_HALF_WIDTH_M, 0.008], mass=0,
            contype=0, conaffinity=0, rgba=[0.8, 0.8, 0.8, 1],
        )
        motor = spec.add_actuator(name=f"wheel{axle}.{side}", target=f"wheel{axle}.{side}")
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    for name, kind in _SENSORS.items():
        spec.add_sensor(name=f"{name}{axle}", type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=f"axle{axle}")


def _add_frame(body: mujoco.MjsBody, plant: dict[str, Any], frame: int, thickness: float) -> mujoco.MjsBody:
    """A strip from an axle to a new axle ahead of it, which is returned without mass."""
    length, bending = plant["strip_length_m"], plant["bending_stiffness_n_m2"]
    step = length / HINGES
    width = 12 * bending / (_YOUNG * thickness**3)
    mass = _DENSITY * width * thickness * step
    # Thin strip: torsion constant b t³/3, second moment of area b t³/12.
    twisting = 2 * bending / (1 + _POISSON)
    place, turn = [plant["rigid_root_m"], 0, 0], plant["clamp_angle_root_rad"]
    body = body.add_body(pos=place, quat=[np.cos(turn / 2), 0, 0, np.sin(turn / 2)])
    _add_segment(body, step / 2, width, thickness, mass / 2)
    for k in range(HINGES):
        body = body.add_body(pos=[step if k else step / 2, 0, 0])
        joints = [("bend", [0, 0, 1], bending / step)]
        if k % _TWIST_EVERY == _TWIST_EVERY // 2:
            joints.insert(0, ("twist", [1, 0, 0], twisting / (_TWIST_EVERY * step)))
        for name, axis, stiffness in joints:
            joint = body.add_joint(
                name=f"{name}{frame}.{k}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, armature=_HINGE_INERTIA
            )
            joint.stiffness = [stiffness, 0, 0]
            joint.damping = [plant["internal_damping_s"] * stiffness, 0, 0]
        _add_segment(body, step if k < HINGES - 1 else step / 2, width, thickness, mass)
    turn = plant["clamp_angle_tip_rad"]
    axle = body.add_body(
        pos=[step / 2 + plant["rigid_tip_m"], 0, 0], quat=[np.cos(turn / 2), 0, 0, np.sin(turn / 2)]
    )
    if frame > 0:
        # A strip does not bend in the vertical plane: without this hinge, one of three axles in a row stands in the air.
        pitch = axle.add_joint(
            name=f"pitch{frame}", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 1, 0], armature=_HINGE_INERTIA
        )
        pitch.damping = [_PITCH_DAMPING, 0, 0]
    return axle


def _add_segment(body: mujoco.MjsBody, length: float, width: float, thickness: float, mass: float) -> None:
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX, size=[length / 2, thickness / 2, width / 2], pos=[length / 2, 0, 0], mass=mass,
        contype=0, conaffinity=0, rgba=[0.75, 0.75, 0.78, 1],
    )
