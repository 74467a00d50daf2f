"""A transmission measured by sensors on both sides: spring, gap, error over the angle, a step with
direction.

The terms are chosen on the recordings to fit to and to choose by, and judged as every finding: each
is taken away, the rest is fitted again, and the cost on untouched recordings decides
(``decide.py``). The search guesses no transmission where one is measured.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import reduce

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.transmission.claims import Claim, claims_of
from zendsp.diagnosis.transmission.findings import (
    findings_of,
    helpful,
    load_behind,
    restated,
    rubbing,
)
from zendsp.diagnosis.transmission.load_side import LoadSide, gap_side, load_side
from zendsp.diagnosis.transmission.motor_side import Motor, joint_inertia
from zendsp.diagnosis.transmission.sets import Sets, compliance_unit, lag_of, sets_of, torque_scale
from zendsp.diagnosis.transmission.shown import STATED, misread, shown
from zendsp.diagnosis.transmission.terms import choose
from zendsp.diagnosis.transmission.torque_sensor import sides_of
from zendsp.diagnosis.transmission.torsion import (
    OF_BODIES,
    OF_MOTOR,
    earlier,
    has_bodies,
    lowpass,
    moved,
)
from zendsp.diagnosis.transmission.waves import waves_of
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term

PASSES = 2  # alternating estimates of the lag and of the errors over the angle
LATE = 0.1  # of a row: a column later than this is shifted
MOVING = 100  # least samples in motion of a set


@dataclass(frozen=True)
class Measured:
    """A measured transmission: findings, terms for the model, what could have been seen, notes."""

    joint: int
    findings: tuple[Finding, ...] = ()
    terms: tuple[Term, ...] = ()
    detectable: tuple[Detectable, ...] = ()
    notes: tuple[str, ...] = ()
    side: LoadSide | None = None  # of a spring that is measured or in the model
    known: bool = False  # the model has a transmission there already
    lag: float = 0.0  # s, by which the second sensor's column is late

    def stated(self, improved: Model) -> tuple[Finding, ...]:
        """The findings, with the numbers of the improved model where these are surer. Beside a
        known spring an error over the angle is one that the motor feels: a ripple shakes the load.
        """
        felt = {t.effect for t in improved.at(self.joint)}
        found = [f for f in self.findings if f.effect in felt or not self.known]
        return tuple(f if self.side is None else restated(f, improved) for f in found)

    def calibrating(self, given: Model) -> Measured:
        """The same with only the terms that stand in place of the given model's own."""
        own = {(t.effect, t.joint) for t in given.terms}
        return replace(self, terms=tuple(t for t in self.terms if (t.effect, t.joint) in own))

    def upon(self, model: Model) -> Model:
        """A model with the measured terms, in place of its own of that kind."""
        ours = {(t.effect, t.joint) for t in self.terms}
        kept = (t for t in model.terms if (t.effect, t.joint) not in ours)
        return model.with_terms((*kept, *self.terms))


def upon(model: Model, found: Sequence[Measured]) -> Model:
    """A model with the terms of all measured transmissions."""
    return reduce(lambda beneath, m: m.upon(beneath), found, model)


def with_ties(parts: Parts, found: Sequence[Measured]) -> Parts:
    """The recordings with what their second sensors say of loads on springs, and with the columns
    of those that are late in time.
    """
    ties = {m.joint: m.side.ties for m in found if m.side is not None}
    parts = replace(parts, fit=replace(parts.fit, ties=ties))
    late = {m.joint: m.lag for m in found if m.lag}
    if not late:
        return parts
    done = {id(data): _punctual(data, late) for data in parts.each}
    return Parts(*(done[id(data)] for data in (parts.fit, parts.choose, parts.test)))


def _punctual(data: Data, late: Mapping[int, float]) -> Data:
    """The recordings with the second sensors' columns of some joints earlier by so many seconds."""

    def in_time(record: JointRecord) -> JointRecord:
        if record.joint not in late:
            return record
        load = earlier(record.columns["position_load"], late[record.joint], record.sample_time)
        columns = {**record.columns, "position_load": load}
        return replace(record, columns=columns, _thinned=None, _once={})

    return replace(data, records=tuple(tuple(map(in_time, rec)) for rec in data.records))


def measured_transmissions(parts: Parts, model: Model, jobs: int) -> list[Measured]:
    """The measured transmissions of all joints with a second sensor behind.

    Parameters
    ----------
    model : Model
        The model behind the transmissions, with found bodies.
    jobs : int
        Threads.
    """
    out = []
    for joint in range(1, model.joints + 1):
        everything = (*parts.fit.records, *parts.choose.records, *parts.test.records)
        if all("position_load" in rec[joint - 1].columns for rec in everything):
            out.append(_measured(parts, model, joint, jobs))
    return out


def without_guesses(
    findings: tuple[Finding, ...], found: Sequence[Measured]
) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """The findings without transmissions that were only guessed where one is measured; and the
    removed ones.
    """
    joints = {m.joint for m in found if m.findings}
    guessed = [f for f in findings if f.mechanism == "transmission" and f.joint in joints]
    return tuple(f for f in findings if f not in guessed), tuple(guessed)


def _measured(parts: Parts, model: Model, joint: int, jobs: int) -> Measured:
    known = [t.effect for t in model.at(joint) if get_effect(t.effect).mechanism == "transmission"]
    raw = sets_of(parts, model, joint)
    if any(int(t.kept.sum()) < MOVING for t in (*raw.fit, *raw.choose, *raw.test)):
        why = f"joint {joint} hardly moves: its position_load was not used"
        return Measured(joint, notes=(why,))
    notes = []
    sides = sides_of(parts, model, joint)
    known_motor = Motor(*sides.motor) if sides else Motor() if has_bodies(model) else None
    band = OF_BODIES if has_bodies(model) and not sides else OF_MOTOR
    inertia = joint_inertia(parts.fit, model, joint)
    lag, waves, straight = _in_time(raw, model, band)
    below = straight.each(lambda t: lowpass(t, band))
    chosen, slow, motor = choose(below, inertia, known_motor)
    side = None
    if not has_bodies(model):
        turns = model.joint_kind(joint) == "rotary"
        gapped = "gap" in chosen.terms
        side = gap_side(straight, turns) if gapped else load_side(below, chosen.terms, turns)
    scale = torque_scale(slow.fit)
    claims = [_spread(c, motor) for c in claims_of(slow, chosen, scale, model)]
    if lag:
        springs = [abs(c.value) for c in claims if c.name == "spring" and known_motor is None]
        instead = misread(raw, band, model, joint) if lag > 0 else ""
        notes.append(_in_words(model, joint, lag, springs, instead))
    if known:
        said = in_figures(claims, compliance_unit(model, joint))
        how = " with the ratio of stiffness and load that they show" if side else " alone"
        notes.append(
            f"joint {joint}: the model has {', '.join(known)} already; the two sensors show {said}."
            f" The model's own numbers are fitted to the position column{how}"
        )
        errors = [] if "transmission_error" in known else waves
        findings, terms = findings_of(parts, model, joint, scale, errors, (0.0, 0.0))
        terms = helpful(with_ties(parts, [Measured(joint, side=side)]), model, joint, terms, jobs)
        rubs = rubbing(model, joint, side)
        notes += [
            f"joint {joint}: of its dry friction about {t.value('load_dry'):.3g}"
            f" {model.torque_unit(joint)} acts on the load, behind the spring"
            for t in rubs
        ]
        return Measured(
            joint, findings, (*terms, *rubs), (), tuple(notes), side, known=True, lag=lag
        )
    load = load_behind(model, inertia, motor)
    findings, terms = findings_of(parts, model, joint, scale, [*claims, *waves], load, side)
    found = {c.name for c in claims}
    seen: tuple[Detectable, ...] = ()
    if not found.issuperset(STATED) and not found & {"gap", "loop"}:
        text, seen = shown(slow, scale, model, joint).unclaimed(joint, tuple(found))
        notes.append(text)
    out = Measured(joint, findings, terms, seen, tuple(notes), side, lag=lag)
    return replace(out, terms=helpful(with_ties(parts, [out]), model, joint, terms, jobs))


def in_figures(claims: Sequence[Claim], unit: str) -> str:
    """What two sensors show, a spring by its compliance in ``unit`` and as a stiffness."""
    said = []
    for claim in claims:
        size = abs(claim.value)
        spring = f" {unit}, a stiffness of {1.0 / size:.3g}" if claim.name == "spring" else ""
        said.append(f"{claim.name} {size:.3g}{spring}")
    return ", ".join(said) or "nothing beyond it"


def _in_time(raw: Sets, model: Model, band: float) -> tuple[float, list[Claim], Sets]:
    """The lag of the second sensor's column, s, 0 where it is small; errors over the angle; the
    torsion without either. Each may look like the other, so they are estimated in turn.
    """
    lag, waves, straight = 0.0, list[Claim](), raw
    for _ in range(PASSES):
        more = lag_of(straight, band)
        lag = lag + more if abs(lag + more) > LATE * raw.fit[0].sample_time else 0.0
        shift = lag
        there = raw.each(lambda t, by=shift: moved(t, by)) if lag else raw  # type: ignore[misc]
        waves, straight = waves_of(there, model)
        if not waves:
            break
    return lag, waves, straight


def _in_words(model: Model, joint: int, lag: float, springs: list[float], instead: str) -> str:
    """A sentence on a lag. ``springs``: compliances measured with the motor's torque, of which
    friction takes a part; such friction looks like an early column. ``instead``: what would be read
    with the lag left in.
    """
    late = f"{1e3 * abs(lag):.3g} ms {'late' if lag > 0 else 'early'} against position"
    if lag < 0 and springs:
        unit = "m" if model.joint_kind(joint) == "linear" else "rad"
        friction = f"{-lag / springs[0]:.2g} {model.torque_unit(joint)} s/{unit}"
        late += f", or viscous friction of {friction} acts before the transmission (it looks alike)"
    left = f" (left in, the sensors would show {instead})" if instead else ""
    return f"joint {joint}: position_load is {late}; taken out{left}"


def _spread(claim: Claim, motor: Motor) -> Claim:
    """A spring with the uncertainty from the motor's inertia added."""
    if claim.name != "spring":
        return claim
    return replace(claim, std=math.hypot(claim.std, motor.compliance * claim.value))
