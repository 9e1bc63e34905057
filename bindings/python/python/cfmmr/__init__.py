"""Control and sensing of a compliant-framed wheeled modular mobile robot: the code of its boards, and its simulator.

    S = Scenario("careful")
    log, end = run(S, seed=31)              one trial: arrays by epoch, and its end
    table = run_many(S.rows(), trials(31, 20), threads=2)
    plant, robot = Plant(S, 31), Robot(S, 31)   the same trial, taken apart

Units are SI. A posture is (x, y, heading): m, m, rad. Lists of axles and frames begin at the front; of two wheels the
left one is first. A seed gives the same bits as `cfmmr posture --seed`, on any number of threads.
"""

from ._native import (
    Boards,
    ControllerInput,
    EstimatorInput,
    InputError,
    Plant,
    Robot,
    RunError,
    Scenario,
    __version__,
    worlds,
)
from .keys import Key, keys
from .logs import read
from .runs import Log, drawn, drawn_plant, frame, run, run_many, run_path, run_paths, summary, trials

__all__ = [
    "Boards",
    "ControllerInput",
    "EstimatorInput",
    "InputError",
    "Key",
    "Log",
    "Plant",
    "Robot",
    "RunError",
    "Scenario",
    "__version__",
    "drawn",
    "drawn_plant",
    "frame",
    "keys",
    "read",
    "run",
    "run_many",
    "run_path",
    "run_paths",
    "summary",
    "trials",
    "worlds",
]
