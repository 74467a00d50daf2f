"""What two sensors on the two sides of a transmission show of it: spring, gap, error over the
angle, a step with direction.

The terms are chosen by the recordings to fit to and to choose by, and judged as every finding is:
each is taken away, the rest is fitted again, and what that costs on recordings that nothing has
touched decides (``decide.py``). The search guesses no transmission where one is measured.
"""

from __future__ import annotations

from dataclasses import dataclass

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.result import Detectable, Finding
from zendsp.diagnosis.transmission.claims import claims_of, least_compliance
from zendsp.diagnosis.transmission.findings import findings_of, helpful, load_behind
from zendsp.diagnosis.transmission.sets import compliance_unit, lag_of, sets_of, torque_scale
from zendsp.diagnosis.transmission.terms import choose
from zendsp.diagnosis.transmission.torsion import (
    OF_BODIES,
    OF_MOTOR,
    has_bodies,
    joint_inertia,
    lowpass,
    moved,
)
from zendsp.diagnosis.transmission.waves import waves_of
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term

LATE = 0.1  # of a row: a column that is later than this is moved
MOVING = 100  # samples of a set in motion: of fewer a transmission tells nothing


@dataclass(frozen=True)
class Measured:
    """A transmission as two sensors show it: findings, the terms that the model gets, what could
    have been seen, notes.
    """

    joint: int
    findings: tuple[Finding, ...] = ()
    terms: tuple[Term, ...] = ()
    detectable: tuple[Detectable, ...] = ()
    notes: tuple[str, ...] = ()


def measured_transmissions(parts: Parts, model: Model, jobs: int) -> list[Measured]:
    """What is found at each joint that has a second sensor behind its transmission.

    Parameters
    ----------
    parts : Parts
    model : Model
        What is behind the transmissions, found bodies included.
    jobs : int
        Threads.
    """
    out = []
    for joint in range(1, model.joints + 1):
        everything = (*parts.fit.records, *parts.choose.records, *parts.test.records)
        if all("position_load" in rec[joint - 1].columns for rec in everything):
            out.append(_measured(parts, model, joint, jobs))
    return out


def _measured(parts: Parts, model: Model, joint: int, jobs: int) -> Measured:
    known = [t.effect for t in model.at(joint) if get_effect(t.effect).mechanism == "transmission"]
    raw = sets_of(parts, model, joint)
    if any(int(t.kept.sum()) < MOVING for t in (*raw.fit, *raw.choose, *raw.test)):
        why = f"joint {joint} hardly moves: its position_load was not used"
        return Measured(joint, notes=(why,))
    notes = []
    band = OF_BODIES if has_bodies(model) else OF_MOTOR
    inertia = joint_inertia(parts.fit, model, joint)
    lag = lag_of(raw, band)
    if abs(lag) > LATE * raw.fit[0].sample_time:
        raw = raw.each(lambda t: moved(t, lag))
        late = "late" if lag > 0 else "early"
        notes.append(
            f"joint {joint}: position_load is {1e3 * abs(lag):.3g} ms {late} against position;"
            " taken out"
        )
    waves, raw = waves_of(raw, model)
    chosen, slow, motor = choose(raw.each(lambda t: lowpass(t, band)), model, inertia)
    scale = torque_scale(slow.fit)
    claims = claims_of(slow, chosen, scale, model)
    if known:
        said = ", ".join(f"{c.name} {abs(c.value):.3g}" for c in claims) or "nothing beyond it"
        notes.append(
            f"joint {joint}: the model has {', '.join(known)} already; the two sensors show {said}"
        )
        return Measured(joint, notes=tuple(notes))
    load = load_behind(model, inertia, motor)
    findings, terms = findings_of(parts, model, joint, scale, claims, waves, load)
    found = {c.name for c in claims}
    seen: tuple[Detectable, ...] = ()
    if "spring" not in found:
        least = least_compliance(slow, chosen, scale, model)
        unit = compliance_unit(model, joint)
        seen = (Detectable(joint, "transmission", "elasticity", least, unit, 0.0),)
        notes.append(
            f"joint {joint}: its two sensors show no compliance; one of {least:.2g} {unit} would"
            " have been seen"
        )
    terms = helpful(parts, model, joint, terms, jobs)
    return Measured(joint, findings, terms, seen, tuple(notes))
