"""Single algorithms of the boards, each built from the parameters of a scenario.

docs/python.md names the paper's equation of each, and the `cfmmr eval` that it replaces.
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
