"""A dictionary of prepared work with a bounded size."""

from __future__ import annotations

from typing import TypeVar

_KEPT = 64  # plans of each kind; a host that asks for ever new names starts over

Key = TypeVar("Key")
Plan = TypeVar("Plan")


def keep(plans: dict[Key, Plan], names: Key, plan: Plan) -> Plan:
    """Remember a plan under its names, and drop others once there are too many."""
    if len(plans) >= _KEPT:
        plans.clear()
    plans[names] = plan
    return plan
