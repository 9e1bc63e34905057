"""Single algorithms of the boards, each with the parameters of a scenario.

    law = KinematicLaw(Scenario("careful"))
    v, kappa, yaw_rate = law.command(posture, goal)

Computed in single precision, as on the boards.
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
]
