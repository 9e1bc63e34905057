"""Single algorithms of the boards, each with the parameters of a scenario.

    law = KinematicLaw(Scenario("careful"))
    v, kappa, yaw_rate = law.command(posture, goal)

Computed in single precision, as on the boards; `strip_equilibrium` of the plant in double precision.
"""

from ._native import (
    AxleFilter,
    Cascade,
    DynamicLaw,
    Fusion,
    Ipec,
    KinematicLaw,
    Planner,
    StrainFit,
    covariance_intersection,
    strip_equilibrium,
)

__all__ = [
    "AxleFilter",
    "Cascade",
    "DynamicLaw",
    "Fusion",
    "Ipec",
    "KinematicLaw",
    "Planner",
    "StrainFit",
    "covariance_intersection",
    "strip_equilibrium",
]
