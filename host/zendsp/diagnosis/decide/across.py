"""Torques over position that several joints lack at once: one cause is likelier than a law each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from zendsp.diagnosis.decide.claims import Claim, Decision
from zendsp.diagnosis.decide.laws import without_law
from zendsp.physics.effects import get_effect

PLACE = "position_torque"


def across_joints(decisions: Sequence[Decision]) -> list[Decision]:
    """The decisions, without laws where several joints lack a torque over position.

    What pulls at several joints (a hose, a strap, a spring between links) has a potential over all
    of them, of which a law at each joint is a section. A ripple is its own motor's, and a body has
    been asked for before.

    Parameters
    ----------
    decisions : sequence of Decision
        One a joint.

    Returns
    -------
    list of Decision
        With the mechanism alone where two joints or more are pulled at; a constant torque at
        another joint is a part of it.
    """
    if sum(any(_pulls(c) for c in d.claims) for d in decisions) < 2:
        return list(decisions)
    return [
        replace(d, claims=tuple(_section(c, d) if _may_be_one(c) else c for c in d.claims))
        for d in decisions
    ]


def _pulls(claim: Claim) -> bool:
    law = get_effect(claim.term.effect) if claim.effect != "unknown" else None
    return claim.mechanism == PLACE and (law is None or "order" not in law.names)


def _may_be_one(claim: Claim) -> bool:
    return claim.effect != "unknown" and (_pulls(claim) or get_effect(claim.effect).constant)


def _section(claim: Claim, decision: Decision) -> Claim:
    return replace(without_law(claim, decision), mechanism=PLACE)
