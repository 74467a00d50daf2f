"""The compliance of a transmission that the motor's sensor alone could not have shown."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Claim, Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.pieces import finest
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.decide.thresholds import LAWFUL, LEFT_BY_A_LAW, MACHINE
from zendsp.diagnosis.measure.discrepancy import beyond
from zendsp.diagnosis.transmission.sets import compliance_unit
from zendsp.diagnosis.transmission.torsion import OF_BODIES, has_bodies, of_bodies
from zendsp.physics.kernel.smooth import lowpassed
from zendsp.physics.model import Model


def by_one_sensor(
    parts: Parts, model: Model, decisions: Sequence[Decision]
) -> tuple[Detectable, ...]:
    """The smallest compliance that the motor's sensor alone would have shown, at each joint of a
    model with bodies that has no other.

    A load that lags behind its motor by c T changes the torque by its inertia times c T̈; the
    unexplained torque can hide as much.
    """
    if not has_bodies(model):
        return ()
    out = []
    for decision in decisions:
        joint = decision.joint
        records = [rec[joint - 1] for rec in parts.test.records]
        if any("position_load" in r.columns for r in records):
            continue
        squares = count = 0.0
        for record in records:
            fs = 1.0 / record.sample_time
            inertia, _ = record.inertia_and_bias(model)
            torque = lowpassed(of_bodies(record, model), min(OF_BODIES, 0.2 * fs), fs)
            bend = inertia * np.gradient(np.gradient(torque, 1.0 / fs), 1.0 / fs)
            edge = max(2, round(0.5 * fs))
            squares += float(np.sum(bend[edge:-edge] ** 2))
            count += len(bend[edge:-edge])
        if squares <= 0.0:  # too short, or at rest: shows no compliance
            continue
        hidden = max(decision.after.value, finest("elasticity", model)) * decision.scale
        least = hidden / math.sqrt(squares / count)
        if least * decision.scale > max(r.scale.position for r in records):
            continue  # a spring bent by more than the travel is no useful figure
        unit = compliance_unit(model, joint)
        out.append(Detectable(joint, "transmission", "elasticity", least, unit, 0.0))
    return tuple(out)


def shown(parts: Parts, model: Model, decisions: Sequence[Decision]) -> list[Decision]:
    """The decisions without springs stiffer than these recordings can show by slow bending. An
    oscillation there has another cause, unless nearly all of the missing torque oscillates with it.
    """
    least = {d.joint: d.size for d in by_one_sensor(parts, model, decisions)}

    def hidden(claim: Claim, decision: Decision) -> bool:
        numbers = claim.term.parameters
        spring = "stiffness" in numbers and "gap" not in numbers
        if not spring or not claim.is_transmission:
            return False
        stiffer = least.get(claim.term.joint, 0.0) * numbers["stiffness"].value > 1.0
        return stiffer and not _swings(claim, decision)

    out = []
    for decision in decisions:
        stiff = [c for c in decision.claims if hidden(c, decision)]
        keep = tuple(c for c in decision.claims if not any(c is s for s in stiff))
        if stiff and not keep:
            little = decision.before.value < MACHINE
            kind = Verdict.COMPLETE if little else Verdict.UNEXPLAINED
            decision = replace(decision, kind=kind)
        out.append(replace(decision, claims=keep, refinements=(*decision.refinements, *stiff)))
    return out


def _swings(claim: Claim, decision: Decision) -> bool:
    """Whether a spring is seen by how its load oscillates: it explains nearly all of a missing
    torque that follows earlier motion by more than in a complete machine.
    """
    lacks = decision.before.value
    return (
        beyond(claim.size, decision.known.all) > LAWFUL
        and claim.size > (1.0 - LEFT_BY_A_LAW) * lacks  # not explained by something else
        and decision.after.value < LEFT_BY_A_LAW * lacks
    )


def unseen(
    parts: Parts, model: Model, decisions: Sequence[Decision]
) -> tuple[Detectable, ...]:
    """The smallest compliance that would have been seen, of joints that a motor drives. None is
    stated where a transmission is found: of two springs of an arm one took up the other, which was
    said not to show.
    """
    sprung = any(c.is_transmission for d in decisions for c in d.claims)
    found = () if sprung else by_one_sensor(parts, model, decisions)
    return tuple(d for d in found if d.joint not in parts.undriven)


def said(unshown: Sequence[Detectable]) -> list[str]:
    """The note on compliance that a single sensor per joint could not have shown; empty where there
    is none.
    """
    if not unshown:
        return []
    listed = ", ".join(f"joint {d.joint} {d.size:.2g} {d.unit}" for d in unshown)
    return [
        "one position sensor a joint: these recordings cannot show a transmission's compliance"
        f" below {listed}"
    ]
