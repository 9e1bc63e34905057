# Compiled module. Import its names from `cfmmr` and `cfmmr.algorithms`. The functions run_columns, path_columns, run_rows, keys_json,
# drawn_json and drawn_plant_json are private to the package.

from collections.abc import Callable, Sequence
from os import PathLike
from typing import Any, Literal, SupportsFloat, SupportsIndex, TypedDict, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

__version__: str

_Array = NDArray[np.float64]
_Pair = tuple[_Array, _Array]
"""Posture (3,): m, m, rad; covariance (3, 3)."""
_Verdict = Literal["used", "gated", "invalid", "absent"]
_Direction = Literal["forward", "reverse"]

class InputError(ValueError):
    """Refused argument or key of a scenario; the attributes are None if the text does not concern one value."""

    field: str | None
    value: str | None
    allowed: str | None

class RunError(Exception):
    """A run that could not continue."""

def worlds() -> list[str]:
    """Names of the built-in worlds."""

def keys_json(table: str | None = None) -> str: ...
def drawn_json(scenario: Scenario, seed: SupportsIndex, trial: SupportsIndex) -> str: ...
def drawn_plant_json(scenario: Scenario, seed: SupportsIndex, trial: SupportsIndex) -> str: ...
def run_columns(
    scenario: Scenario,
    seed: SupportsIndex,
    trial: SupportsIndex,
    parts: Any,
) -> tuple[dict[str, Any], dict[str, Any]]: ...
def path_columns(
    scenario: Scenario,
    path: str | ArrayLike,
    laps: SupportsIndex,
    timed: bool,
    seed: SupportsIndex,
    trial: SupportsIndex,
    parts: Any,
) -> tuple[dict[str, Any], dict[str, Any]]: ...
def run_rows(
    scenarios: Sequence[Scenario],
    trials: Sequence[tuple[SupportsIndex, SupportsIndex]],
    threads: SupportsIndex,
    parts: Any,
) -> dict[str, Any]: ...

@final
class Scenario:
    """Everything a simulation depends on, apart from the seed."""

    def __new__(
        cls, world: str | None = None, text: str = ..., changes: Sequence[str] = ..., axles: SupportsIndex | None = None
    ) -> Scenario: ...
    @staticmethod
    def load(path: str | PathLike[str], world: str | None = None, changes: Sequence[str] = ...) -> Scenario:
        """Reads a scenario from a TOML file."""

    def changed(self, *changes: str) -> Scenario:
        """Copy with further changes of keys, as "plant.friction=0.5"."""

    def rows(self, rows: str = "main") -> list[Scenario]:
        """Scenarios of the rows of `cfmmr posture`: main, pair, joint or all."""

    @property
    def world(self) -> str:
        """Name of the world, with ", changed" if a value differs."""

    @property
    def label(self) -> str:
        """Sensors and fusion as in a row of `cfmmr posture`."""

    def toml(self) -> str:
        """The whole scenario as TOML."""

    def __getitem__(self, key: str, /) -> Any:
        """Value of a key; a table gives a dict."""

    def __eq__(self, value: object, /) -> bool: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class Plant:
    """Simulated plant of a drawn robot, at rest at its true start."""

    def __new__(cls, scenario: Scenario, seed: SupportsIndex, trial: SupportsIndex | None = None) -> Plant: ...
    def sensed_into(self, out: _Array) -> None:
        """Writes the sensed values into `out`, float64 of shape (sensed_count,)."""

    @property
    def sensed_count(self) -> int:
        """Number of sensed values."""

    @property
    def sensed_names(self) -> list[str]:
        """Names of the sensed values with their units."""

    def step_with(self, torque: ArrayLike) -> None:
        """Advances by 1 ms with wheel torques, shape (axles, 2): left and right, N m."""

    def steps(self, count: SupportsIndex, torque: ArrayLike) -> None:
        """Advances by `count` ms with constant wheel torques, shape (axles, 2), N m."""

    def place(self, midpoint: ArrayLike) -> None:
        """Places the robot at rest with its midpoint at a posture (3,): m, m, rad."""

    def lift_wheel(self, axle: SupportsIndex, side: SupportsIndex) -> None:
        """Lifts a wheel off the floor: number of the axle, then 0 for left or 1 for right."""

    def snap_frame(self, frame: SupportsIndex) -> None:
        """Breaks a frame."""

    @property
    def time_s(self) -> float:
        """Time since the start, s."""

    @property
    def midpoint(self) -> _Array:
        """True posture of the midpoint (3,): m, m, rad."""

    @property
    def axles(self) -> _Array:
        """True postures of the axles (axles, 3): m, m, rad."""

    @property
    def velocities(self) -> _Array:
        """Velocities of the axles (axles, 3): forward and to the left, m/s; yaw rate, rad/s."""

    @property
    def wheel_speeds(self) -> _Array:
        """Wheel speeds (axles, 2): left and right, rad/s."""

    @property
    def torques(self) -> _Array:
        """Wheel torques (axles, 2): left and right, N m."""

    @property
    def relative(self) -> _Array:
        """Postures of each axle in the frame of the axle behind it (frames, 3): m, m, rad."""

    @property
    def wrenches(self) -> _Array:
        """Wrenches of the frames (frames, 4): force forward and to the left, N; moment at root and tip, N m."""

    def frame_points(self) -> _Array:
        """Points of the bent frames from root to tip (frames, 13, 2), m."""

@final
class Robot:
    """Boards, sensors and bus of a drawn robot. The physics is the caller's."""

    def __new__(
        cls,
        scenario: Scenario,
        seed: SupportsIndex,
        trial: SupportsIndex | None = None,
        *,
        controller: Callable[[], Any] | None = None,
        estimator: Callable[[], Any] | None = None,
    ) -> Robot: ...
    def step_into(self, sensed: ArrayLike, torque: _Array) -> None:
        """One millisecond: sensed (sensed_count,) in; torque, float64 of shape (axles, 2), N m, is written."""

    @property
    def sensed_count(self) -> int:
        """Number of sensed values."""

    @property
    def sensed_names(self) -> list[str]:
        """Names of the sensed values with their units."""

    @property
    def strains(self) -> _Array:
        """Strains as the beam boards read them (frames, 8), from the root; 0 where there is no gauge."""

    def regulate(self, goal: ArrayLike | None = None) -> None:
        """Drives the midpoint to a posture (3,): m, m, rad; by default the goal of the scenario."""

    def follow(self, points: str | ArrayLike, laps: SupportsIndex = 1, timed: bool = False) -> None:
        """Follows a path: waypoints (n, 2), m, or a name of `run_path`; with `timed` as a trajectory."""

    def drive(self, speed_m_s: SupportsFloat, curvature: SupportsFloat) -> None:
        """Drives with a speed (m/s) and a curvature (1/m) of the midpoint, for at most 200 ms."""

    def stop(self) -> None:
        """Brakes and holds."""

    def idle(self) -> None:
        """Switches the motors off."""

    def clear(self) -> None:
        """Clears latched faults whose causes are gone."""

    @property
    def time_s(self) -> float:
        """Time since the start, s."""

    @property
    def done(self) -> bool:
        """True if the task is done and the robot at rest."""

    @property
    def lead(self) -> dict[str, Any]:
        """Output of the lead node by column of the log, without "lead."."""

    def estimate_into(self, out: _Array) -> None:
        """Writes posture (m, m, rad) and covariance, row by row, into `out`, float64 of shape (12,)."""

    @property
    def posture(self) -> _Array:
        """Estimated posture of the midpoint (3,): m, m, rad."""

    @property
    def covariance(self) -> _Array:
        """Covariance of the estimated posture (3, 3)."""

    @property
    def notices(self) -> list[str]:
        """Names of the notices and degradations since the latest task."""

    @property
    def fault(self) -> str | None:
        """Reason that the robot stopped with a fault; None if it did not."""

@final
class Boards:
    """Boards and bus of a drawn robot. Sensors and physics are the caller's."""

    def __new__(
        cls,
        scenario: Scenario,
        seed: SupportsIndex,
        trial: SupportsIndex | None = None,
        *,
        controller: Callable[[], Any] | None = None,
        estimator: Callable[[], Any] | None = None,
    ) -> Boards: ...
    def step(
        self,
        encoder: ArrayLike,
        counts: ArrayLike,
        gyro: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
    ) -> _Array:
        """One millisecond; gives torques (axles, 2), N m.

        encoder (axles, 2): counts, NaN if missing. counts (frames, gauges): of the converters. gyro (axles,): rad/s.
        acceleration (axles,): m/s².
        """

    def regulate(self, goal: ArrayLike | None = None) -> None:
        """Drives the midpoint to a posture (3,): m, m, rad; by default the goal of the scenario."""

    def follow(self, points: str | ArrayLike, laps: SupportsIndex = 1, timed: bool = False) -> None:
        """Follows a path: waypoints (n, 2), m, or a name of `run_path`; with `timed` as a trajectory."""

    def drive(self, speed_m_s: SupportsFloat, curvature: SupportsFloat) -> None:
        """Drives with a speed (m/s) and a curvature (1/m) of the midpoint, for at most 200 ms."""

    def stop(self) -> None:
        """Brakes and holds."""

    def idle(self) -> None:
        """Switches the motors off."""

    def clear(self) -> None:
        """Clears latched faults whose causes are gone."""

    @property
    def time_s(self) -> float:
        """Time since the start, s."""

    @property
    def done(self) -> bool:
        """True if the task is done and the robot at rest."""

    @property
    def lead(self) -> dict[str, Any]:
        """Output of the lead node by column of the log, without "lead."."""

    def estimate_into(self, out: _Array) -> None:
        """Writes posture (m, m, rad) and covariance, row by row, into `out`, float64 of shape (12,)."""

    @property
    def posture(self) -> _Array:
        """Estimated posture of the midpoint (3,): m, m, rad."""

    @property
    def covariance(self) -> _Array:
        """Covariance of the estimated posture (3, 3)."""

    @property
    def notices(self) -> list[str]:
        """Names of the notices and degradations since the latest task."""

    @property
    def fault(self) -> str | None:
        """Reason that the robot stopped with a fault; None if it did not."""

@final
class ControllerInput:
    """Input of a user's controller in an epoch of 10 ms."""

    @property
    def posture(self) -> _Array:
        """Estimated posture of the midpoint (3,): m, m, rad."""

    @property
    def goal(self) -> _Array:
        """Goal of the midpoint (3,): m, m, rad, in the same coordinates."""

    @property
    def steering_rad(self) -> float:
        """Commanded steering angle."""

    @property
    def speed_m_s(self) -> float:
        """Commanded velocity of the midpoint."""

    @property
    def tolerance(self) -> tuple[float, float]:
        """Tolerance of the goal: m, rad."""

@final
class EstimatorInput:
    """Input of a user's estimator in an epoch of 10 ms; None for a missing message."""

    @property
    def front(self) -> _Pair | None:
        """Motion of the front axle by its odometry, in the coordinates it had."""

    @property
    def rear(self) -> _Pair | None:
        """Motion of the rear axle by its odometry, in the coordinates it had."""

    @property
    def beam(self) -> _Pair | None:
        """Front axle in the coordinates of the rear axle, measured by the gauges."""

class _Fit(TypedDict):
    posture: _Array
    covariance: _Array
    wrench: _Array | None
    chi_square: float | None
    method: Literal["piecewise", "quadrature", "elastica"]

@final
class StrainFit:
    """Posture of the frame's tip from the strains of one instant."""

    def __new__(cls, scenario: Scenario) -> StrainFit: ...
    @property
    def gauges(self) -> int:
        """Number of gauges."""

    def fit(self, strain: ArrayLike) -> _Fit:
        """Fit of the strains (gauges,), from the root."""

    def postures(self, strain: ArrayLike) -> _Array:
        """Postures of many sets of strains, (n, gauges) to (n, 3): m, m, rad. NaN where no posture fits."""

@final
class AxleFilter:
    """Extended Kalman filter of an axle: x, y (m), heading (rad), v (m/s), yaw rate (rad/s), the rates of both."""

    def __new__(
        cls, scenario: Scenario, state: ArrayLike | None = None, covariance: ArrayLike | None = None
    ) -> AxleFilter: ...
    def step(
        self,
        left: SupportsFloat | None = None,
        right: SupportsFloat | None = None,
        gyro: SupportsFloat | None = None,
        acceleration: SupportsFloat | None = None,
    ) -> list[_Verdict]:
        """Prediction, then update by wheel speeds (m/s), yaw rate (rad/s), acceleration (m/s²); None if absent."""

    def update_posture(self, posture: ArrayLike, covariance: ArrayLike) -> _Verdict:
        """Update by a posture (3,): m, m, rad, with covariance (3, 3)."""

    @property
    def state(self) -> _Array:
        """State (7,)."""

    @property
    def covariance(self) -> _Array:
        """Covariance of the state (7, 7)."""

def covariance_intersection(
    a: ArrayLike,
    a_covariance: ArrayLike,
    b: ArrayLike,
    b_covariance: ArrayLike,
    criterion: str = "determinant",
) -> tuple[float, _Array, _Array]:
    """Weight of a, fused posture (3,): m, m, rad, and covariance (3, 3). criterion: determinant or trace."""

@final
class Ipec:
    """Internal posture error correction of the odometry of two axles."""

    def __new__(cls, scenario: Scenario, axle1: ArrayLike, axle2: ArrayLike) -> Ipec: ...
    def step(self, advance: ArrayLike, relative: ArrayLike) -> list[float]:
        """One interval: advance (4,), m, of the wheels; relative (3,): axle 2 seen from axle 1. Corrections, rad."""

    @property
    def postures(self) -> _Array:
        """Postures of both axles (2, 3): m, m, rad."""

    @property
    def variance(self) -> float:
        """Variance of the heading from axle 1 to axle 2 since the start, rad²."""

@final
class Fusion:
    """Fusion of both axles and the frame on the lead node."""

    def __new__(
        cls, scenario: Scenario, posture: ArrayLike | None = None, covariance: ArrayLike | None = None
    ) -> Fusion: ...
    def step(
        self,
        front: Sequence[ArrayLike] | None = None,
        rear: Sequence[ArrayLike] | None = None,
        beam: Sequence[ArrayLike] | None = None,
    ) -> _Verdict:
        """One epoch of 10 ms; each argument is a pair of posture (3,) and covariance (3, 3)."""

    @property
    def robot(self) -> _Pair:
        """Midpoint."""

    @property
    def front(self) -> _Pair:
        """Front axle; zero before the first step."""

    @property
    def rear(self) -> _Pair:
        """Rear axle; zero before the first step."""

@final
class KinematicLaw:
    """Curvature-based kinematic law of the midpoint (paper eq. 4), before limits."""

    def __new__(cls, scenario: Scenario) -> KinematicLaw: ...
    def command(
        self,
        postures: ArrayLike,
        reference: ArrayLike,
        v_r: SupportsFloat = 0.0,
        kappa_r: SupportsFloat = 0.0,
    ) -> _Array:
        """Velocity (m/s), curvature (1/m) and yaw rate (rad/s) at postures (3,) or (n, 3); of the same shape."""

@final
class Cascade:
    """Cascade from the midpoint's motion to references of the axles (paper eq. 5 and 6)."""

    def __new__(cls, scenario: Scenario) -> Cascade: ...
    @property
    def max_curvature(self) -> float:
        """Path curvature at the largest steering angle, 1/m."""

    def curvature(self, steering_rad: SupportsFloat) -> float:
        """Path curvature at a steering angle, 1/m."""

    def steering(self, curvature: SupportsFloat, rate: SupportsFloat = 0.0) -> tuple[float, float]:
        """Steering angle (rad) and its rate (rad/s) for a curvature (1/m) and its rate (1/(m s))."""

    def references(
        self,
        midpoint: ArrayLike,
        v: SupportsFloat,
        steering_rad: SupportsFloat,
        steering_rate_rad_s: SupportsFloat = 0.0,
    ) -> tuple[_Array, _Array]:
        """Postures (2, 3): m, m, rad; velocities and yaw rates (2, 2): m/s, rad/s; front first."""

@final
class DynamicLaw:
    """Robust dynamic law of an axle (paper eq. 7 to 10)."""

    def __new__(cls, scenario: Scenario) -> DynamicLaw: ...
    def torques(
        self,
        posture: ArrayLike,
        twist: ArrayLike,
        reference: ArrayLike,
        reference_twist: ArrayLike,
        acceleration: ArrayLike | None = None,
        load: ArrayLike | None = None,
    ) -> list[float]:
        """Torques of the left and right wheel, N m.

        posture, reference (3,): m, m, rad. twist, reference_twist (2,): m/s, rad/s. acceleration (2,): m/s², rad/s².
        load (3,): force forward and to the left, N; moment, N m.
        """

class _Plan(TypedDict):
    segments: list[tuple[_Direction, float, float]]
    """Direction, curvature (1/m), length (m)."""
    approach: _Direction
    cost_m: float

@final
class Planner:
    """Planner of posture regulation: up to two segments of constant curvature into the funnel."""

    def __new__(cls, scenario: Scenario) -> Planner: ...
    def plan(self, posture: ArrayLike, goal: ArrayLike) -> _Plan | None:
        """Plan from a posture to a goal (3,): m, m, rad; None if no plan leads into the funnel."""

class _Equilibrium(TypedDict):
    wrench: _Array
    root_moment: float
    curvature: _Array
    stable: bool

def strip_equilibrium(
    length_m: float,
    bending_n_m2: float,
    axial_n: float,
    tip: ArrayLike,
    curvature: ArrayLike,
) -> _Equilibrium:
    """Equilibrium of the plant's strip between two clamps, in double precision.

    tip (3,): m, m, rad, the end in the coordinates of the root. curvature (5,): 1/m at 0.1, 0.3, 0.5, 0.7 and 0.9 of
    the length, near the wanted branch. wrench (3,): N, N, N m.
    """
