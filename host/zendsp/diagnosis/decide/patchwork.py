"""Laws that together imitate a curve that none of them is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from zendsp.diagnosis.decide.claims import Claim, Piece
from zendsp.diagnosis.decide.thresholds import (
    BASE_LEFT,
    CURVE,
    FALSE_DISCOVERIES,
    FINEST,
    GROWN,
    HARMONIC,
    LAW_ERROR,
    PLAIN,
    TWINS,
)
from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.diagnosis.measure.significance import counterpart, deviation
from zendsp.physics.effects import get_effect, mechanism_of, stands_on
from zendsp.physics.model import Model, Term


def stand_on_nothing(final: Scored, joint: int, scale: float) -> tuple[Term, ...]:
    """The laws of a joint that stand upon another one of which hardly anything is left. A Stribeck
    curve without Coulomb friction is merely some curve over the speed, as one that falls to an
    eighth is. ``scale``: RMS torque, N m or N.
    """
    at = final.model.at(joint)

    def is_nothing(term: Term) -> bool:
        law = get_effect(term.effect)
        upon = [t for t in at if t.effect != law.name and stands_on(law, t.effect)]
        sizes = [t.value(get_effect(t.effect).parameters[0].name) for t in (*upon, term)]
        return bool(upon) and max(sizes[:-1]) < max(FINEST * scale, BASE_LEFT * sizes[-1])

    return tuple(t for t in at if is_nothing(t))


def makes_another_grow(given: Model, final: Scored, law: Term) -> bool:
    """Whether a friction of the given model surely has to be several times larger beside a law of
    the same mechanism. Then both together imitate the missing torque, as v and v² do |v|^1.5. A
    right law leaves the others as they are, or takes back what they had absorbed.
    """
    mechanism = mechanism_of(law.effect)

    def grows(known: Term) -> bool:
        key = get_effect(known.effect).parameters[0].name
        was, now = known.value(key), counterpart(final.model.terms, known).value(key)
        return 0.0 < GROWN * was < now - PLAIN * deviation(final.fit, known, key)

    left = {t.effect for t in final.model.at(law.joint)}
    return any(
        grows(t)
        for t in given.at(law.joint)
        if t.effect in left and t.effect != law.effect and mechanism_of(t.effect) == mechanism
    )


def twins(claims: Sequence[Claim], final: Scored) -> tuple[Claim, ...]:
    """The waves of two mechanisms at once that are equal in order and amplitude; or that the travel
    cannot tell apart, one of them surely no whole number a turn. Together they imitate something
    else, such as a ripple of the torque constant, or a torque that grows with place and speed.
    """

    def alike(a: Claim, b: Claim) -> bool:
        waves = [c.term.parameters for c in (a, b)]
        if a.mechanism == b.mechanism or not all("phase" in wave for wave in waves):
            return False
        equal = all(
            all(n in wave for wave in waves)
            and abs(waves[0][n].value - waves[1][n].value) < TWINS * abs(waves[0][n].value)
            for n in ("order", "amplitude")
        )
        return equal or _one_wave([a.term, b.term], final)

    return tuple(a for a in claims if any(alike(a, b) for b in claims))


def _one_wave(waves: Sequence[Term], final: Scored) -> bool:
    """Whether the travel cannot tell two waves apart, and one is surely no whole number a turn."""
    joint = waves[0].joint
    if final.model.joint_kind(joint) == "linear":
        return False
    travel = max(rec[joint - 1].scale.position for rec in final.data.records)
    # one without an order is once a turn
    orders = [t.value("order", 1.0) for t in waves]
    unsure = [deviation(final.fit, t, "order") for t in waves]
    broken = any(
        abs(n - round(n)) > PLAIN * off for n, off in zip(orders, unsure, strict=True)
    )
    return broken and abs(orders[0] - orders[1]) * travel < 2 * math.pi


def both_needed(final: Scored, law: Claim, other: Claim) -> bool:
    """Whether two laws of a mechanism are both real and not pieces of a curve: two springs with one
    neutral point are one hardening spring, and a torque may be both delayed and slow, where
    untouched recordings show both. (A lag that they did not show took 1 ms of a delay of 4 ms.)
    """
    terms = [c.term for c in (law, other)]
    if law.mechanism != other.mechanism or law.term.effect == other.term.effect:
        return False
    if all(get_effect(t.effect).family == "timing" for t in terms):
        return other.log_e > 0 and other.evidence.z > PLAIN
    if not all("neutral" in t.parameters for t in terms):
        return False
    apart = abs(terms[0].value("neutral") - terms[1].value("neutral"))
    travel = max(rec[law.term.joint - 1].scale.position for rec in final.data.records)
    unsure = PLAIN * math.hypot(*(deviation(final.fit, t, "neutral") for t in terms))
    return apart <= max(unsure, LAW_ERROR * travel)


def draws_a_curve(claim: Claim) -> bool:
    """Whether a claim is a torque over position without a law."""
    return claim.effect == "unknown" and claim.mechanism == "position_torque"


def bends(final: Scored, other: Claim, law: Claim, apart: bool) -> bool:
    """Whether a second law of a mechanism takes up what the first leaves: one that only refines it
    (not ``apart``, a finding of its own), or the same law once more. Harmonics, or a law with other
    settings, are one law; one that stands upon another is one with it; a delay is no curve.
    """
    one, more = get_effect(law.effect), get_effect(other.effect)
    waves = "order" in one.names and "order" in more.names
    settings = one is more and not all(p.fitted for p in one.parameters)
    upon = one.coupled or bool(more.needs) or stands_on(one, more.name)
    if waves or settings or upon or "timing" in (one.family, more.family):
        return False
    return (not apart or one is more) and not both_needed(final, law, other)


def is_curve(ranked: Sequence[Piece], travel: float) -> bool:
    """Whether laws over the position, all of them needed, are pieces of a curve: several laws, or
    ripples that are no harmonics of one, or that the ``travel`` cannot separate (together they are
    one wave that fades along it).
    """
    held = [p for p in ranked if p.log_e > 0 and p.evidence.z > PLAIN]
    repeats = sorted(p.terms[0].value("order") for p in held if "order" in p.terms[0].parameters)
    if any((b - a) * travel < 2 * math.pi for a, b in pairwise(repeats)):
        return True
    if len(held) < CURVE:
        return False
    orders = [p.terms[0].value("order") for p in held if "order" in p.terms[0].parameters]
    if len(orders) < len(held):
        return True
    ratios = np.array(orders) / min(orders)
    return bool(np.any(np.abs(ratios - np.round(ratios)) > HARMONIC))


def _divides_a_turn(period: float, unsure: float) -> bool:
    """Whether a period is a whole part of a turn, and known so well that by chance it would not be.
    """
    parts = max(round(2 * math.pi / period), 1)
    window = PLAIN * unsure
    by_chance = 2.0 * window * parts / period  # whole parts of a turn are a period / parts apart
    return abs(2 * math.pi / parts - period) <= window and by_chance < FALSE_DISCOVERIES


def part_of_a_wave(term: Term, beside: int, travel: float, unsure: float = math.inf) -> bool:
    """Whether the ``travel`` shows less than a period of a law over the position, so that any curve
    would do. ``unsure``: of its period or order; infinite where no joint turns.

    A period that is a whole part of a turn is believed, as of something that turns with the joint.
    A law of one period a turn is doubted over less than a turn (rad), where ``beside`` other laws
    over the position stand beside it; unless it is balanced at a multiple of a quarter turn, where
    an axis has its zero. A sensor errs a whole number of times a turn, so its wave is doubted where
    it is ``unsure`` of that number.
    """
    names = get_effect(term.effect).names
    if "order" in names and get_effect(term.effect).site == "sensor":
        return math.inf > 2 * PLAIN * unsure > 1.0
    if "period" in names:
        period = term.value("period")
        return period > travel and not _divides_a_turn(period, unsure)
    if get_effect(term.effect).shape != "angle" or not beside or travel >= 2 * math.pi:
        return False
    angle = term.parameters["angle"]
    off = math.remainder(angle.value, math.pi / 2)
    return abs(off) > PLAIN * angle.std
