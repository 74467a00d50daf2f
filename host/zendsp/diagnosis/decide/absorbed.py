"""Physics that a free parameter of the mechanism has absorbed: a payload, a wrong gain.

Calibration moves inertia and gravity freely. A few percent are the tolerance of any given number; a
shift far beyond is a finding. A gain error scales inertia, gravity and friction alike, exactly:
where all of them have moved by one factor, it is named with them.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.decide.assemble import Assembled
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.findings import Estimate, Finding
from zendsp.diagnosis.decide.moved import FAR, known_point, one_factor, times, weight_gone
from zendsp.diagnosis.decide.pieces import finest
from zendsp.diagnosis.decide.thresholds import PLAIN, TOLERANCE
from zendsp.diagnosis.measure.discrepancy import difference
from zendsp.diagnosis.measure.evidence import compare
from zendsp.diagnosis.measure.likelihood import fit_scored
from zendsp.diagnosis.search.candidates import as_given
from zendsp.physics.calibration.fit import Data, joint_handles
from zendsp.physics.calibration.joint import effective_inertia
from zendsp.physics.effects import get_effect, library, mechanism_of
from zendsp.physics.model import Model
from zendsp_protocol.views import with_std

# of two numbers together: the root of the χ² with two degrees of freedom that is as
# unlikely (0.27 %); and the least of each of them. Chosen, not measured: the one case met had 3.0
# and 4.8
FAR_TOGETHER, NEAR = 3.44, 2.0
WEIGHT_ALONE = 2.0  # times FAR, of a weight that moves without its inertia
ONE_GAIN = 0.5  # of the inertia's change: numbers that move within it may be one torque gain
GAINED = 0.9  # confidence of one gain for three numbers and more; not learned: too few cases
INSISTS = 100.0  # deviance on the recordings of the fit that the given value costs at least
PAYS, SURELY = 50.0, 3.0  # the same on untouched ones, and in standard deviations over blocks
BOTH = ("inertia", "gravity")
# the number of each of two effects that are the same to first order
TIMES = {"lag": "time_constant", "delay": "time"}
# of a given time, which is hardly better known than this. A delay beside a lag moved it by 140 to
# 2040 %; none of 50 complete machines (seed 401) has such a finding
LATER = 0.5
# s, and errors of the sensor: a joint whose position bends less over that time shows no inertia. At
# constant speed it was 0.6 to 1.2; slow motion of complete machines (seed 1811) has 4.6 and more
BEND, BENT = 0.25, 2.0


def shifted(
    given: Model, decision: Decision, whole: Assembled, found: Collection[str], test: Data
) -> list[tuple[float, float, Finding]]:
    """Findings about mechanism parameters that calibration moved far from their given values. Each
    comes with its z and with the torque that the given value would leave unexplained, as a part of
    the RMS torque.

    Parameters
    ----------
    test : Data
        Held-out recordings, which the shift has to make likelier too.
    found : collection of str
        Effects already found at the joint; an effect that carries inertia itself explains the
        shift.

    Returns
    -------
    list of (float, float, Finding)
    """
    joint = decision.joint
    sprung = any(
        effect in library() and get_effect(effect).family == "transmission" for effect in found
    )
    late = [] if TIMES.keys() & set(found) else _later(given, decision, whole, test)
    if late or sprung or "torque_gain" in found:
        return late
    if given.of_bodies:
        return _rotor(given, decision, whole, test)
    if given.kind not in ("rotary", "linear"):
        return []
    main = "inertia" if given.kind == "rotary" else "mass"
    moves = _moves(given, whole.improved, joint)
    if not _accelerates(test, joint):  # which shows its weight alone
        moves.pop(main, None)
    both = [moves[key][1] for key in (main, "gravity") if key in moves]
    heavier = len(both) == 2 and _both_far(*both)
    if main not in moves or not (abs(moves[main][1]) > FAR or heavier):
        gone, own = weight_gone(given, whole.improved, joint), mechanism_of("gravity")
        if gone and any(name in library() and mechanism_of(name) == own for name in found):
            return []  # what was found stands in its place
        return _gravity_only(given, decision, moves, test, gone)
    ratio, z, amount, std = moves[main]
    if 0.0 < ratio < _by_unseen(whole.improved, joint, test):
        return []
    if heavier:
        z = math.copysign(math.hypot(z, moves["gravity"][1]), z)
    factor = one_factor(given, whole.improved, joint)
    held = _held(given, decision, main) if factor is None else _as_given(given, decision)
    # that all numbers move alike is no chance
    size = _size(held, decision, test, SURELY if factor is None else PLAIN)
    if size is None:
        return []
    if factor is not None:
        return [(z, size, _gain(joint, factor))]
    unit = "kg m²" if given.kind == "rotary" else "kg"
    wrong = "the given number is wrong"
    what = f"the joint bears a payload, or {wrong}" if amount > 0 else wrong
    same = []
    others = [m for key, m in moves.items() if key != main]
    if all(abs(m[0] - ratio) < ONE_GAIN * abs(ratio) for m in others):
        same.append("torque_gain")
    if others and any(abs(m[1]) > FAR for m in others):
        same.append("gravity")
    values = {"amount": Estimate(amount, std, unit)}
    text = (
        f"Calibration moves the {main} of joint {joint} by {_by(amount, ratio, std, unit)}"
        f"{_weight(given, joint, moves)}, far beyond the tolerance of a given number: {what}."
        f"{_as_point(moves)}"
    )
    if same:
        text += f" This recording cannot tell it from {', '.join(same)}."
    sure = min(0.9, 0.5 + 0.05 * abs(z))
    return [(z, size, _finding("inertia", joint, values, sure, tuple(same), text))]


def _moves(
    given: Model, improved: Model, joint: int
) -> dict[str, tuple[float, float, float, float]]:
    """How far calibration moved each free number of a joint's mechanism: relative, in tolerances,
    absolute, and the new number's standard deviation.
    """
    moves = {}
    for key, items in given.mechanism.items():
        index = joint - 1 if len(items) > 1 else 0
        if joint > 1 and len(items) == 1:
            continue
        before, after = items[index], improved.mechanism[key][index]
        if not before.free or before.value == 0:
            continue
        ratio = after.value / before.value - 1.0
        known = max(TOLERANCE, before.std / abs(before.value))
        spread = math.hypot(known, after.std / abs(before.value))
        moves[key] = (ratio, ratio / spread, after.value - before.value, after.std)
    return moves


def _both_far(inertia: float, gravity: float) -> bool:
    """Whether inertia and weight together moved further than the tolerance allows, in the same
    direction, as when a body was added or removed. Both numbers are in tolerances.
    """
    same = inertia * gravity > 0.0 and min(abs(inertia), abs(gravity)) > NEAR
    return same and math.hypot(inertia, gravity) > FAR_TOGETHER


def _weight(
    given: Model, joint: int, moves: dict[str, tuple[float, float, float, float]]
) -> str:
    """A clause on a weight that moved too."""
    ratio, z, amount, std = moves.get("gravity", (0.0, 0.0, 0.0, 0.0))
    if abs(z) < FAR:
        return ""
    return f" and its gravity torque by {_by(amount, ratio, std, given.torque_unit(joint))}"


def _as_point(moves: Mapping[str, tuple[float, float, float, float]]) -> str:
    """The payload that explains both, where inertia and weight have grown. It is as uncertain as
    the given numbers that it is measured from; one that may be next to nothing, or anywhere, is not
    stated.
    """
    if not all(key in moves and moves[key][1] > NEAR for key in BOTH):
        return ""
    grown = []
    for key, unit in zip(BOTH, ("kg m²", "N m"), strict=True):
        ratio, _, amount, std = moves[key]
        grown.append(Estimate(amount, math.hypot(std, TOLERANCE * amount / ratio), unit))
    inertia, weight = grown
    where = known_point(inertia, weight)
    return f" A payload of {where} from the axis would do both." if where else ""


def _gain(joint: int, factor: Estimate) -> Finding:
    """The finding of one torque gain error, where calibration scaled all numbers of a joint alike.
    """
    text = (
        f"Calibration multiplies all numbers of joint {joint} by {factor.value:.3g}: its torque is"
        f" {1.0 / factor.value:.3g} times what the given model says, as by a wrong gain, gear ratio"
        " or unit. This recording cannot tell it from inertia."
    )
    ratio = Estimate(1.0 / factor.value - 1.0, factor.std / factor.value**2, "1")
    return _finding("torque_gain", joint, {"ratio": ratio}, GAINED, ("inertia",), text)


def _later(
    given: Model, decision: Decision, whole: Assembled, test: Data
) -> list[tuple[float, float, Finding]]:
    """A wrong lag or delay of the given model, as a number that calibration moved. A given lag
    takes up a delay that is missing beside it, and the other way round.
    """
    joint, out = decision.joint, []
    for effect, key in TIMES.items():
        both = [[t for t in m.at(joint) if t.effect == effect] for m in (given, whole.improved)]
        if any(len(terms) != 1 for terms in both):
            continue
        alone = [t for t in decision.alone.model.at(joint) if t.effect == effect]
        if len(alone) != 1:
            continue
        before, after = (terms[0].parameters[key] for terms in both)
        amount = after.value - before.value
        far = math.hypot(LATER * before.value, FAR * after.std)
        if not before.free or before.value <= 0.0 or abs(amount) < far:
            continue
        model = decision.alone.model
        terms = tuple(both[0][0].held() if t is alone[0] else t for t in model.terms)
        size = _size(model.with_terms(terms), decision, test)
        if size is None or size < finest(effect, model):
            continue
        other = next(name for name in TIMES if name != effect)
        name = key.replace("_", " ")
        text = (
            f"Calibration moves the {name} of the {effect} of joint {joint} by"
            f" {_by(amount, amount / before.value, after.std, 's')}: the command acts"
            f" {'later' if amount > 0.0 else 'sooner'} than the model says. Here this is the same"
            f" as another {other}."
        )
        z = amount / math.hypot(LATER * before.value / FAR, after.std)
        values = {key: Estimate(after.value, after.std, "s")}
        sure = min(0.9, 0.5 + 0.05 * abs(z))
        out.append((z, size, _finding(effect, joint, values, sure, (other,), text)))
    return out


def _rotor(
    given: Model, decision: Decision, whole: Assembled, test: Data
) -> list[tuple[float, float, Finding]]:
    """The rotor inertia that a model states beside the bodies of its file, as a number that
    calibration moved.
    """
    joint = decision.joint
    both = [
        [t for t in m.at(joint) if t.effect == "inertia"]
        for m in (given, decision.alone.model, whole.improved)
    ]
    if any(len(terms) != 1 for terms in both):
        return []
    (stated,), (fitted,), (improved,) = both
    before, after = stated.parameters["amount"], improved.parameters["amount"]
    if not before.free or before.value <= 0.0:
        return []
    amount = after.value - before.value
    part = _by_unseen(whole.improved, joint, test)
    if part and 0.0 < amount < part * _inertia(whole.improved, joint, test):
        return []
    z = amount / math.hypot(max(TOLERANCE * before.value, before.std), after.std)
    fixed = stated.held()
    terms = tuple(fixed if t is fitted else t for t in decision.alone.model.terms)
    size = _size(decision.alone.model.with_terms(terms), decision, test) if abs(z) >= FAR else None
    if size is None:
        return []
    unit = "kg" if given.joint_kind(joint) == "linear" else "kg m²"
    text = (
        f"Calibration moves the rotor inertia of joint {joint} by"
        f" {_by(amount, amount / before.value, after.std, unit)}, far beyond the tolerance of a"
        " given number: it is wrong. Where only its own acceleration shows it, a link or a"
        " payload of another mass is the same."
    )
    values = {"amount": Estimate(amount, after.std, unit)}
    sure = min(0.9, 0.5 + 0.05 * abs(z))
    return [(z, size, _finding("inertia", joint, values, sure, ("body", "payload"), text))]


def _accelerates(test: Data, joint: int) -> bool:
    """Whether accelerations show in the position: over a quarter of a second it bends by more than
    the sensor's error. Of a joint that turns at constant speed the rounding bends as much, which
    goes into the command; its inertia was "a factor of 0.09".
    """
    for rec in test.records:
        record = rec[joint - 1]
        y, half = record.position, max(1, round(0.5 * BEND / record.sample_time))
        bend = y[2 * half :] - 2.0 * y[half:-half] + y[: -2 * half]
        if float(bend @ bend) > BENT**2 * 6.0 * record.measurement.std**2 * len(bend):
            return True
    return not test.records


def _by_unseen(improved: Model, joint: int, test: Data) -> float:
    """The part by which an inertia may come out too large because commands between the rows are
    unknown. They are an error of the regressor (errors in variables); a larger inertia responds
    less to it. The value is the error's mean square over that of the accelerating torque.
    """
    unseen = needed = 0.0
    for rec in test.records:
        record = rec[joint - 1]
        torque = effective_inertia(record, improved) * record.motion.states[2]
        unseen += record.between**2 * record.n
        needed += float(torque @ torque)
    return unseen / max(needed, 1e-300)


def _inertia(model: Model, joint: int, test: Data) -> float:
    """The mean inertia of a joint with all that it moves, kg m² or kg."""
    return float(np.mean([np.mean(effective_inertia(r[joint - 1], model)) for r in test.records]))


def _held(given: Model, decision: Decision, *keys: str) -> Model:
    """The model of a joint with some mechanism parameters put back to their given values."""
    held = {key: tuple(replace(q, free=False) for q in given.mechanism[key]) for key in keys}
    model = decision.alone.model
    return replace(model, mechanism={**model.mechanism, **held})


def _as_given(given: Model, decision: Decision) -> Model:
    """The model of a joint with all of its given numbers. Beside dry friction, which is most of a
    small motor's torque, a recording may hardly show the inertia alone.
    """
    own = given.at(decision.joint)
    terms = as_given(decision.alone.model, given).terms
    terms = tuple(t.held() if any(t is g for g in own) else t for t in terms)
    return _held(given, decision, *given.mechanism).with_terms(terms)


def _size(
    held: Model, decision: Decision, test: Data, surely: float = SURELY
) -> float | None:
    """The torque that the model leaves unexplained without a shift, as a part of the RMS torque.
    None where some recordings, held-out ones included, do not clearly prefer the shift. Only the
    claims stand beside it: refinements would be bent to make up for a wrong mass.
    """
    final, joint = decision.alone, decision.joint
    handles = joint_handles(final.data, held, joint)
    fixed = fit_scored(final.data, held, handles, (joint,), rounds=3)
    if fixed.deviance - final.deviance < INSISTS:
        return None
    # as for any finding: it must be more than what stays unexplained
    size = difference(test, fixed.model, final.model, joint)
    if size <= max(decision.after.value, decision.state.size):
        return None
    evidence = compare(fixed, final, test, joint)
    return size if evidence.gain > PAYS and evidence.z > surely else None


def _gravity_only(
    given: Model,
    decision: Decision,
    moves: dict[str, tuple[float, float, float, float]],
    test: Data,
    gone: bool,
) -> list[tuple[float, float, Finding]]:
    if "gravity" not in moves or abs(moves["gravity"][1]) < WEIGHT_ALONE * FAR:
        return []
    joint, size = decision.joint, _size(_held(given, decision, "gravity"), decision, test)
    if size is None:
        return []
    ratio, z, amount, std = moves["gravity"]
    values = {
        "torque": Estimate(abs(amount), std, given.torque_unit(joint)),
        "angle": Estimate(0.0 if amount > 0 else math.pi, 0.0, "rad"),
    }
    why = "there is an unbalance, or the given number is wrong"
    if gone:
        why = "nothing weighs here, or it is balanced"
    elif ratio < -1.0:  # it pulls the other way
        why = "position 0 is where it stands upright ([sensor] offset), or the sign is wrong"
    text = (
        f"Calibration moves the gravity torque of joint {joint} by"
        f" {_by(amount, ratio, std, given.torque_unit(joint))}, far beyond the tolerance of a"
        f" given number: {why}."
    )
    return [(z, size, _finding("gravity", joint, values, 0.7, ("stiffness",), text))]


def _by(amount: float, ratio: float, std: float, unit: str) -> str:
    """The change of a given number in words, with its new value."""
    given = amount / ratio
    return f"{times(ratio)} (from {given:.3g} to {with_std(given + amount, std, unit)})"


def _finding(
    effect: str,
    joint: int,
    values: dict[str, Estimate],
    sure: float,
    same: tuple[str, ...],
    text: str,
) -> Finding:
    mechanism, laws = mechanism_of(effect), {effect: 1.0}
    return Finding(effect, joint, values, sure, 0.0, same, (), text, {}, mechanism, laws)
