"""The robot in MuJoCo. Needs the package mujoco: pip install 'cfmmr[mujoco]'.

    from cfmmr.mujoco import maker
    log, end = run(Scenario("careful"), seed=31, plant=maker("rough:10"))
"""

try:
    import mujoco as _mujoco  # noqa: F401
except ImportError as error:
    raise ImportError("cfmmr.mujoco needs the package mujoco: pip install 'cfmmr[mujoco]'") from error

from .grounds import Ground
from .robot import MuJoCoRobot, maker

__all__ = ["Ground", "MuJoCoRobot", "maker"]
