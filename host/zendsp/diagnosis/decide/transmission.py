"""What two sensors on the two sides of a transmission show of it: spring, gap, error over the
angle, a step with direction.

The terms are chosen by the recordings to fit to and to choose by, and judged as every finding is:
each is taken away, the rest is fitted again, and what that costs on recordings that nothing has
touched decides (``decide.py``). The search guesses no transmission where one is measured.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.signal import butter, sosfiltfilt

from zendsp.diagnosis.data.reading import Parts
from zendsp.diagnosis.decide.confidence import MOST
from zendsp.diagnosis.decide.decide import FALSE_DISCOVERIES, FINEST, PLAIN, SURE, Decision
from zendsp.diagnosis.decide.findings import number, sentence
from zendsp.diagnosis.decide.mechanisms import LAWS_OF
from zendsp.diagnosis.measure.evidence import Evidence, compare
from zendsp.diagnosis.measure.torsion import (
    OF_BODIES,
    OF_MOTOR,
    Array,
    Linear,
    Twist,
    columns_of,
    evidence,
    has_bodies,
    joined,
    joint_inertia,
    judged,
    lowpass,
    moved,
    of_bodies,
    regress,
    rms,
    strongest_order,
    twists,
    wave,
    with_motor_torque,
)
from zendsp.diagnosis.result import Detectable, Estimate, Finding
from zendsp.diagnosis.search.forward import calibrate_joint
from zendsp.physics.effects import get_effect, unit_of
from zendsp.physics.model import Model, Quantity, Term

OPEN = 0.3  # of the RMS torque: below, a gap may be open
POWER = 1.28  # standard deviations: nine in ten
LATE = 0.1  # of a row: a column that is later than this is moved
OF_A_GAP = 0.05  # of its width: so much too narrow it came out of a simulated one of 20 mrad
WAVES = 2  # errors over the angle, at most
ENOUGH = 1.0  # of what stays unexplained: what is less is no finding
# the simpler first; a spring may stand beside an encoder disc that is off centre
CHOICES: tuple[tuple[str, ...], ...] = (
    (),
    ("step",),
    ("spring",),
    ("spring", "step"),
    ("gap",),
    ("spring", "gap"),
    ("spring", "cubic"),
)


@dataclass(frozen=True)
class Chosen:
    """The terms of a transmission and whether a disc off centre stands beside them."""

    terms: tuple[str, ...]
    off_centre: bool
    fit: Linear
    deviance: float


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


@dataclass(frozen=True)
class _Sets:
    """The three parts of the data at one joint."""

    fit: list[Twist]
    choose: list[Twist]
    test: list[Twist]

    def each(self, change: Callable[[Twist], Twist]) -> _Sets:
        """The same with every recording changed."""
        return _Sets(*([change(t) for t in part] for part in (self.fit, self.choose, self.test)))


def _sets(parts: Parts, model: Model, joint: int) -> _Sets:
    """Raw torsion; halves of one recording share their sensors' zeros."""
    fit = twists(parts.fit, model, joint)
    choose = twists(parts.choose, model, joint)
    if parts.choose is parts.test:
        return _Sets(fit, choose, choose)
    test = twists(parts.test, model, joint)
    if len(choose) == len(test) == 1 and _follows(parts, joint):
        choose, test = [[joined(choose[0], test[0], part)] for part in (0, 1)]
    return _Sets(fit, choose, test)


def _follows(parts: Parts, joint: int) -> bool:
    """Whether the recording to test on begins where the one to choose by ends."""
    first, second = parts.choose.records[0][joint - 1], parts.test.records[0][joint - 1]
    gap = second.t0 - first.t0 - first.n * first.sample_time
    return abs(gap) < 0.5 * first.sample_time


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
    raw = _sets(parts, model, joint)
    if any(int(t.kept.sum()) < 100 for t in (*raw.fit, *raw.choose, *raw.test)):
        why = f"joint {joint} hardly moves: its position_load was not used"
        return Measured(joint, notes=(why,))
    notes = []
    band = OF_BODIES if has_bodies(model) else OF_MOTOR
    inertia = joint_inertia(parts.fit, model, joint)
    lag = _lag(raw, band)
    if abs(lag) > LATE * raw.fit[0].sample_time:
        raw = raw.each(lambda t: moved(t, lag))
        late = "late" if lag > 0 else "early"
        notes.append(
            f"joint {joint}: position_load is {1e3 * abs(lag):.3g} ms {late} against position;"
            " taken out"
        )
    waves, raw = _waves(raw, model)
    chosen, slow, motor = _chosen(raw.each(lambda t: lowpass(t, band)), model, inertia)
    scale = _scale(slow.fit)
    claims = _claims(slow, chosen, scale, model)
    if known:
        said = ", ".join(f"{c.name} {abs(c.value):.3g}" for c in claims) or "nothing beyond it"
        notes.append(
            f"joint {joint}: the model has {', '.join(known)} already; the two sensors show {said}"
        )
        return Measured(joint, notes=tuple(notes))
    load = _load(model, inertia, motor)
    findings, terms = _findings(parts, model, joint, scale, claims, waves, load)
    found = {c.name for c in claims}
    seen: tuple[Detectable, ...] = ()
    if "spring" not in found:
        least = _least(slow, chosen, scale, model)
        unit = unit_of("position", model.joint_kind(joint)) + "/(" + _torque(model, joint) + ")"
        seen = (Detectable(joint, "transmission", "elasticity", least, unit, 0.0),)
        notes.append(
            f"joint {joint}: its two sensors show no compliance; one of {least:.2g} {unit} would"
            " have been seen"
        )
    helpful = _helpful(parts, model, joint, terms, jobs)
    return Measured(joint, findings, helpful, seen, tuple(notes))


def _torque(model: Model, joint: int) -> str:
    return "N" if model.joint_kind(joint) == "linear" else "N m"


def _lag(raw: _Sets, band: float) -> float:
    """Time by which the second sensor's column is late, s: torsion that goes with speed beside all
    that a transmission may do.
    """
    slow = [lowpass(t, band) for t in raw.fit]
    columns, y = [], []
    for t in slow:
        parts = [t.qd, t.torque, t.drive, t.qdd, t.extra["direction"]]
        parts += [np.ones_like(t.q), np.sin(t.q), np.cos(t.q)]
        columns.append(np.stack(parts, axis=1)[t.kept])
        y.append(t.torsion[t.kept])
    a = np.concatenate(columns)
    norms = np.linalg.norm(a, axis=0)
    x = np.linalg.lstsq(a / np.where(norms > 0, norms, 1.0), np.concatenate(y), rcond=1e-9)[0]
    return -float(x[0] / norms[0])


def _scale(twists: Sequence[Twist]) -> float:
    return max(rms([t.torque[t.kept] for t in twists]), 1e-300)


def _loaded(twist: Twist) -> Twist:
    """Without the rows at which a gap may be open: no law says on which side of it the load is."""
    size = rms([twist.torque[twist.kept]])
    return replace(twist, kept=twist.kept & (np.abs(twist.torque) > OPEN * size))


def _may_be_off(slow: _Sets) -> bool:
    """Whether an encoder's disc off centre is a slow error here: a full turn shows what it is."""
    return all(float(np.ptp(t.q[t.kept])) < 2 * math.pi for t in slow.fit)


def _fit(twists: Sequence[Twist], terms: Sequence[str], off: bool, scale: float) -> Linear:
    return regress(twists, [columns_of(t, terms, scale) for t in twists], off)


def _apply(
    twists: Sequence[Twist], terms: Sequence[str], off: bool, scale: float, x: Array
) -> list[Array]:
    return regress(twists, [columns_of(t, terms, scale) for t in twists], off, x).residual


def _physical(terms: Sequence[str], x: Array) -> bool:
    """Whether a spring gives way, a gap opens and a step goes against the motion."""
    at, ok = 0, True
    for term in terms:
        ok &= float(x[at]) > 0 if term == "cubic" else float(x[at]) < 0
        at += 2 if term == "spring" else 1
    return ok


def _chosen(slow: _Sets, model: Model, inertia: float) -> tuple[Chosen, _Sets, tuple[float, float]]:
    """The terms that describe the fit recordings best for their number and hold on those to choose
    by; with the transmitted torque that goes with them.
    """
    best: tuple[Chosen, _Sets, tuple[float, float]] | None = None
    for off in (False, True) if _may_be_off(slow) else (False,):
        here, motor = slow, (0.0, 0.0)
        if not has_bodies(model):
            fit, others, jm, std = with_motor_torque(
                slow.fit, (slow.choose, slow.test), inertia, off
            )
            here, motor = _Sets(fit, others[0], others[1]), (jm, std)
        here = here.each(_loaded)
        scale = _scale(here.fit)
        for terms in CHOICES:
            found = _fit(here.fit, terms, off, scale)
            if not _physical(terms, found.x):
                continue
            n = sum(len(r) for r in found.residual)
            _, log_e = evidence(_fit(here.fit, (), False, scale).residual, found.residual, here.fit)
            kept = _apply(here.choose, terms, off, scale, found.x)
            _, held = evidence(_fit(here.choose, (), False, scale).residual, kept, here.choose)
            count = len(found.x) + 2 * off * len(here.fit)
            deviance = -2.0 * (log_e + held) + count * math.log(n)
            if best is None or deviance < best[0].deviance:
                best = Chosen(terms, off, found, deviance), here, motor
    assert best is not None
    return best


@dataclass(frozen=True)
class _Claim:
    """One term that the untouched recordings need."""

    name: str
    value: float
    std: float
    evidence: Evidence
    log_e: float
    size: float  # RMS, rad or m
    left: float  # RMS of what stays unexplained beyond the sensors' noise
    order: float = 0.0
    phase: float = 0.0
    order_std: float = 0.0
    damping: tuple[float, float] = (0.0, 0.0)
    same: tuple[str, ...] = ()


def _needed(model: Model) -> float:
    return math.log(model.joints * len(LAWS_OF) / FALSE_DISCOVERIES)


def _left(residual: Sequence[Array], twists: Sequence[Twist]) -> float:
    noise = max(t.noise for t in twists)
    return math.sqrt(max(rms(judged(twists, residual)) ** 2 - noise**2, 0.0))


def _apart(twists: Sequence[Twist], one: Sequence[Array], other: Sequence[Array]) -> float:
    """RMS difference of two residuals where they are evidence."""
    return rms(judged(twists, [a - b for a, b in zip(one, other, strict=True)]))


def _claims(slow: _Sets, chosen: Chosen, scale: float, model: Model) -> list[_Claim]:
    """The chosen terms, each taken away and judged on the untouched recordings.

    A disc off centre may explain a short piece as well as a spring does: the spring is judged with
    it and without. Where the recordings of the fit do not tell them apart, that is said.
    """
    alike = "spring" in chosen.terms and _like_a_disc(slow, scale, model)
    out = []
    for term in chosen.terms:
        claim = _judged(slow, chosen, term, scale, model)
        if claim is None and term == "spring" and _may_be_off(slow):
            off = not chosen.off_centre
            other = replace(chosen, off_centre=off, fit=_fit(slow.fit, chosen.terms, off, scale))
            if _physical(other.terms, other.fit.x):
                claim = _judged(slow, other, term, scale, model)
        if claim is not None:
            same = ("encoder_eccentricity",) if alike and term == "spring" else ()
            out.append(replace(claim, same=same))
    return out


def _judged(
    slow: _Sets, chosen: Chosen, term: str, scale: float, model: Model
) -> _Claim | None:
    with_all = _apply(slow.test, chosen.terms, chosen.off_centre, scale, chosen.fit.x)
    left = _left(with_all, slow.test)
    gone = ("spring", "cubic") if term == "spring" else (term,)
    rest = tuple(t for t in chosen.terms if t not in gone)
    again = _fit(slow.fit, rest, chosen.off_centre, scale)
    without = _apply(slow.test, rest, chosen.off_centre, scale, again.x)
    found, log_e = evidence(without, with_all, slow.test)
    size = _apart(slow.test, without, with_all)
    at = sum(2 if t == "spring" else 1 for t in chosen.terms[: chosen.terms.index(term)])
    x, std = chosen.fit.x, np.sqrt(np.maximum(np.diag(chosen.fit.covariance), 0.0))
    value, spread = float(x[at]), float(std[at])
    sure = log_e > _needed(model) and found.z > PLAIN and abs(value) > SURE * spread
    if not sure or size <= ENOUGH * left:
        return None
    damping = (0.0, 0.0)
    if term == "spring":
        damping = float(x[at + 1]) / value, float(std[at + 1]) / abs(value)
    return _Claim(term, value, spread, found, log_e, size, left, damping=damping)


def _like_a_disc(slow: _Sets, scale: float, model: Model) -> bool:
    """Whether a disc off centre explains the fit recordings as well as a spring beside it does."""
    if not _may_be_off(slow):
        return False
    disc, both = (_fit(slow.fit, terms, True, scale) for terms in ((), ("spring",)))
    _, log_e = evidence(disc.residual, both.residual, slow.fit)
    return log_e < _needed(model) or both.x[0] >= 0


def _least(slow: _Sets, chosen: Chosen, scale: float, model: Model) -> float:
    """The smallest compliance that would have been claimed, with 90 % probability."""
    columns = [columns_of(t, ("spring",), scale)[:, :1] for t in slow.test]
    alone = regress(slow.test, columns, chosen.off_centre)
    nothing = regress(slow.test, columns, chosen.off_centre, np.zeros(1))
    unit = regress(
        [replace(t, torsion=t.torque) for t in slow.test], columns, chosen.off_centre, np.zeros(1)
    )
    size = max(rms(unit.residual), 1e-300)
    count = sum(len(r) for r in alone.residual)
    error = math.hypot(
        math.sqrt(float(alone.covariance[0, 0])),
        max(t.noise for t in slow.test) / (size * math.sqrt(count)),
    )
    root = POWER + math.sqrt(POWER**2 + 2.0 * _needed(model))
    left = _left(nothing.residual, slow.test)
    return max(root * error, left / size)


def _waves(raw: _Sets, model: Model) -> tuple[list[_Claim], _Sets]:
    """Errors over the angle, up to the recordings' own rate, and the torsion without them.

    Beside them stands all that is slow: torque, acceleration, direction, a disc off centre. A gear
    need not mesh with the same teeth after another homing: a recording may choose the phase anew,
    and only the phase.
    """
    out: list[_Claim] = []
    while len(out) < WAVES:
        order = strongest_order(raw.fit, _beneath(raw.fit).residual)
        claim = _wave(raw, model, order) if order else None
        if claim is None:
            break
        out.append(claim)
        known = _beneath(raw.fit, claim.order).x
        raw = raw.each(lambda t, c=claim, x=known: _straight(t, c, x))  # type: ignore[misc]
    return out, raw


def _beneath(twists: Sequence[Twist], order: float = 0.0, known: Array | None = None) -> Linear:
    """Torsion regressed on all that is slow and, where it is not 0, on one order."""
    columns = []
    for t in twists:
        slow = np.stack([t.torque, t.drive, t.qdd, np.sign(t.qd)], axis=1)[t.kept]
        columns.append(np.concatenate([slow, wave(t, order)], axis=1) if order else slow)
    return regress(twists, columns, True, known)


def _own_phase(twist: Twist, order: float, slow: Array) -> float:
    """The phase of an order in one recording."""
    (residual,) = _beneath([twist], known=slow).residual
    sine, cosine = np.linalg.lstsq(wave(twist, order), residual, rcond=None)[0]
    return math.atan2(cosine, sine)


def _straight(twist: Twist, claim: _Claim, x: Array) -> Twist:
    """The torsion without an error over the angle, of the phase that it has in this recording."""
    phase = _own_phase(twist, claim.order, x[:-2])
    error = claim.value * np.sin(claim.order * twist.q + phase)
    return replace(twist, torsion=twist.torsion - error)


def _wave(raw: _Sets, model: Model, order: float) -> _Claim | None:
    span = max(float(np.ptp(t.q[t.kept])) for t in raw.fit)
    width = math.pi / span

    def cost(n: float) -> float:
        return rms(_beneath(raw.fit, n).residual)

    order = float(minimize_scalar(cost, bounds=(order - width, order + width), method="bounded").x)
    found, again = _beneath(raw.fit, order), _beneath(raw.fit)
    sine, cosine = float(found.x[-2]), float(found.x[-1])
    amplitude, phase = math.hypot(sine, cosine), math.atan2(cosine, sine)
    std = math.sqrt(float(np.mean(np.diag(found.covariance)[-2:])))
    without, with_it = [], []
    for twist in raw.test:
        here = _own_phase(twist, order, found.x[:-2])
        known = np.r_[found.x[:-2], amplitude * math.cos(here), amplitude * math.sin(here)]
        with_it += _beneath([twist], order, known).residual
        without += _beneath([twist], known=again.x).residual
    held, log_e = evidence(without, with_it, raw.test)
    log_e -= 0.5 * len(raw.test) * math.log(sum(len(r) for r in with_it))  # of the phases
    size, left = _apart(raw.test, without, with_it), _left(with_it, raw.test)
    sure = log_e > _needed(model) and held.z > PLAIN and amplitude > SURE * std
    if not sure or size <= ENOUGH * left:
        return None
    # of a sine's frequency, from its phase at both ends of the range (Rife and Boorstyn 1974)
    order_std = math.sqrt(12.0) * std / amplitude / span
    return _Claim("wave", amplitude, std, held, log_e, size, left, order, phase, order_std)


# --- one sensor only


def by_one_sensor(
    parts: Parts, model: Model, decisions: Sequence[Decision]
) -> tuple[Detectable, ...]:
    """The smallest compliance that the motor's sensor alone would have shown, at each joint of a
    model with bodies that has no other.

    A load that lags behind its motor by c T lacks the torque of its inertia times c T̈; what stays
    unexplained hides as much.
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
            sos = butter(4, min(OF_BODIES, 0.2 * fs), fs=fs, output="sos")
            inertia, _ = record.inertia_and_bias(model)
            torque = sosfiltfilt(sos, of_bodies(record, model))
            bend = inertia * np.gradient(np.gradient(torque, 1.0 / fs), 1.0 / fs)
            edge = max(2, round(0.5 * fs))
            squares += float(np.sum(bend[edge:-edge] ** 2))
            count += len(bend[edge:-edge])
        hidden = max(decision.after.value, FINEST) * decision.scale
        least = hidden / max(math.sqrt(squares / max(count, 1.0)), 1e-300)
        unit = unit_of("position", model.joint_kind(joint)) + "/(" + _torque(model, joint) + ")"
        out.append(Detectable(joint, "transmission", "elasticity", least, unit, 0.0))
    return tuple(out)


def said(unseen: Sequence[Detectable]) -> list[str]:
    """The note on what one sensor a joint could not have shown; none where there is nothing."""
    if not unseen:
        return []
    listed = ", ".join(f"joint {d.joint} {d.size:.2g} {d.unit}" for d in unseen)
    return [
        "one position sensor a joint: these recordings cannot show a transmission's compliance"
        f" below {listed}"
    ]


# --- findings


def _load(model: Model, inertia: float, motor: tuple[float, float]) -> tuple[float, float]:
    """Inertia behind the transmission, with its standard deviation; 0 where the bodies say it."""
    if has_bodies(model):
        return 0.0, 0.0
    return max(inertia - motor[0], 0.02 * inertia), motor[1]


def _sure(claim: _Claim) -> float:
    ratio = (claim.size / max(claim.left, 1e-300)) ** 1.5
    return float(min(MOST, ratio / (0.5 + ratio)))


def _findings(
    parts: Parts,
    model: Model,
    joint: int,
    scale: float,
    claims: Sequence[_Claim],
    waves: Sequence[_Claim],
    load: tuple[float, float],
) -> tuple[tuple[Finding, ...], tuple[Term, ...]]:
    """Findings with the contract's names, and the terms that go into the model."""
    by = {c.name: c for c in claims}
    made: list[tuple[str, _Claim, dict[str, tuple[float, float]], dict[str, object]]] = []
    spring = by.get("spring")
    if spring is not None:
        stiffness = -1.0 / spring.value
        relative = spring.std / abs(spring.value)
        numbers = {"stiffness": (stiffness, relative * stiffness)}
        if spring.damping[0] > PLAIN * spring.damping[1]:
            numbers["damping"] = spring.damping
        if load[0]:
            numbers["load_inertia"] = load
        details: dict[str, object] = {"compliance": -spring.value, "compliance_std": spring.std}
        name = "elasticity"
        if "gap" in by:
            name, numbers = "backlash", {"gap": _gap(by["gap"]), **numbers}
        elif "cubic" in by:
            name = "stiffening"
            bend = by["cubic"].value * stiffness**4 / scale**2
            numbers["stiffness3"] = bend, by["cubic"].std / by["cubic"].value * bend
        made.append((name, spring, numbers, details))
    elif "gap" in by:
        made.append(("backlash", by["gap"], {"gap": _gap(by["gap"])}, {}))
    if "step" in by and spring is None:
        step = by["step"]
        made.append(("hysteresis", step, {"step": (-2 * step.value, 2 * step.std)}, {}))
    for w in waves:
        numbers = {
            "order": (w.order, w.order_std),
            "amplitude": (w.value, w.std),
            "phase": (w.phase, w.std / w.value),
        }
        made.append(("transmission_error", w, numbers, {}))
    everything = sum(c.size**2 for _, c, _, _ in made) or 1.0
    findings = tuple(
        _finding(model, joint, name, claim, numbers, details, claim.size**2 / everything)
        for name, claim, numbers, details in made
    )
    terms = tuple(_term(model, parts, name, joint, numbers) for name, _, numbers, _ in made)
    return findings, tuple(t for t in terms if t is not None)


def _gap(claim: _Claim) -> tuple[float, float]:
    """Full width, and its standard deviation."""
    width = -2.0 * claim.value
    return width, math.hypot(2.0 * claim.std, OF_A_GAP * width)


def _term(
    model: Model, parts: Parts, name: str, joint: int, numbers: dict[str, tuple[float, float]]
) -> Term | None:
    """A held term: the motor's position says less of it than the two sensors. None where the
    kernel has no such law.

    What was not measured: all that the bodies are is the load, and the spring loses a twentieth of
    critical.
    """
    if name == "hysteresis" or (name == "backlash" and "stiffness" not in numbers):
        return None
    known = dict(numbers)
    if "stiffness" in known:
        inertia = joint_inertia(parts.fit, model, joint)
        load = known.setdefault("load_inertia", (_bodies(parts, model, joint), 0.0))[0]
        damping = 0.1 * math.sqrt(known["stiffness"][0] * min(load, inertia))
        known.setdefault("damping", (damping, 0.0))
    values = {
        p.name: Quantity(max(known[p.name][0], p.lower), False, "", known[p.name][1])
        for p in get_effect(name).parameters
    }
    return Term(name, joint, values)


def _bodies(parts: Parts, model: Model, joint: int) -> float:
    """Mean inertia of the bodies behind a joint, kg m² or kg."""
    inertia, _ = parts.fit.records[0][joint - 1].inertia_and_bias(model)
    return float(np.mean(inertia))


def _finding(
    model: Model,
    joint: int,
    name: str,
    claim: _Claim,
    numbers: dict[str, tuple[float, float]],
    details: dict[str, object],
    share: float,
) -> Finding:
    effect = get_effect(name)
    kind, torque = model.joint_kind(joint), model.torque_unit(joint)
    values = {}
    for key, (value, std) in numbers.items():
        size = next((p.size for p in effect.parameters if p.name == key), "position")
        values[key] = Estimate(value, std, unit_of(size, kind, model.actuator.unit, torque))
    if name == "hysteresis":
        text = (
            f"The transmission of joint {joint} steps by {number(values['step'])} as the direction"
            " changes: lost motion, or a spring behind dry friction."
        )
    elif name == "elasticity":
        text = f"Joint {joint} is elastic: stiffness {number(values['stiffness'])}."
    else:
        text = sentence(Term(name, joint, {}), values)
    text += " Measured by the sensors on both sides of its transmission."
    if claim.same:
        text += f" This recording cannot tell it from {', '.join(claim.same)}."
    same = claim.same
    sure = _sure(claim) * (0.5 + 0.5 / (1 + len(same)))
    return Finding(
        name,
        joint,
        values,
        sure,
        share,
        same,
        (),
        text,
        {"details": {"sensors": "both sides", **details}},
        effect.mechanism,
        {name: 1.0},
    )


def _helpful(
    parts: Parts, model: Model, joint: int, terms: tuple[Term, ...], jobs: int
) -> tuple[Term, ...]:
    """The measured terms, where the motor's own prediction is no worse with them."""
    if not terms:
        return ()
    plain = calibrate_joint(parts.fit, model, joint, jobs)
    bent = calibrate_joint(parts.fit, model.with_terms((*model.terms, *terms)), joint, jobs)
    return terms if compare(plain, bent, parts.choose, joint).gain > 0 else ()
