"""Keys of a scenario, from the declarations that the boards, the simulator and `cfmmr keys` use."""

import json
from dataclasses import dataclass
from typing import Any

from . import _native


@dataclass(frozen=True)
class Key:
    """A key of a scenario."""

    key: str
    unit: str
    default: Any
    """Default without a world; None if the key is not set."""
    allowed: str
    """Allowed values in words."""
    meaning: str
    range: tuple[float, float] | None = None
    """Smallest and largest value, where both are allowed."""
    choices: tuple[str, ...] | None = None
    whole: bool = False
    """True for whole numbers."""


def keys(table: str | None = None) -> list[Key]:
    """All keys, or those of a table such as "robot.limits", with unit, default, allowed values and meaning."""
    return [_key(**entry) for entry in json.loads(_native.keys_json(table))]


def _key(*, range: Any = None, choices: Any = None, **rest: Any) -> Key:
    return Key(**rest, range=range and tuple(range), choices=choices and tuple(choices))
