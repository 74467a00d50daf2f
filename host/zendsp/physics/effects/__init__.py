"""The library of physical effects, one file each. ``load_effects`` adds those of a user's file."""

from zendsp.physics.effects.base import MECHANISMS, Effect, Parameter, unit_of
from zendsp.physics.effects.catalogue import (
    get_effect,
    is_supported,
    laws_of,
    library,
    load_effects,
    mechanism_of,
    stands_on,
)

__all__ = [
    "MECHANISMS", "Effect", "Parameter", "get_effect", "is_supported", "laws_of", "library",
    "load_effects", "mechanism_of", "stands_on", "unit_of",
]
