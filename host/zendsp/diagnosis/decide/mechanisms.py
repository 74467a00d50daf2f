"""Mechanisms of a machine and the laws that write them down, as the effect files say."""

from __future__ import annotations

from zendsp.physics.effects import MECHANISMS, laws_of, mechanism_of

__all__ = ["LAWS_OF", "mechanism_of"]

LAWS_OF: dict[str, tuple[str, ...]] = {mechanism: laws_of(mechanism) for mechanism in MECHANISMS}
