"""One calibrated and one improved model of the whole machine from the searches of its joints."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.thresholds import SPRINGS_SHIFT, SURE, TOLERANCE
from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.diagnosis.measure.significance import INTEGRATION_ERROR
from zendsp.physics.calibration.convergence import with_step_error
from zendsp.physics.calibration.covariance import robust_covariance
from zendsp.physics.calibration.fit import Data, Fit, block_count, fit
from zendsp.physics.calibration.handles import LEADER, free_handles, set_values
from zendsp.physics.calibration.joint import own_terms
from zendsp.physics.model import Model, Quantity, Term
from zendsp.physics.robots.bodies import body_terms

# s: blocks of the covariance that is reported. With random torques of 1 % that last 0.2 s and 1.5 s
# 0.25 s gave numbers that were off by 1.18 and 1.36 standard deviations, 1 s 0.98 and 1.09 (165 and
# 185 numbers of three machines of another maker)
LASTING = 1.0
BLOCKS_A_NUMBER = 3  # such blocks for each free number: fewer are too alike after the fit


@dataclass(frozen=True)
class Assembled:
    """Models in kernel form. ``fits[j]`` holds the numbers of joint j with their covariance; in
    ``agreed[j]`` the covariance includes the disagreement of other recordings. ``data`` has the
    final observers.
    """

    calibrated: Model
    improved: Model
    fits: dict[int, Fit]
    agreed: dict[int, Fit]
    data: Data


def shared_mechanism(model: Model) -> bool:
    """Whether one free mechanism parameter acts on several joints."""
    if model.joints == 1:
        return False
    return any(
        len(items) == 1 and items[0].free and items[0].value != 0
        for items in model.mechanism.values()
    )


def merge(given: Model, parts: Sequence[Scored]) -> Model:
    """One model of the whole machine from the fits of its joints. A term that acts on all joints
    appears once, as in the given model.
    """
    shared = body_terms(given)
    terms: list[Term] = list(shared)
    mechanism = {key: list(items) for key, items in given.mechanism.items()}
    offset = [
        (
            given.sensor.offset[j]
            if j < len(given.sensor.offset)
            else (given.sensor.offset or (0.0,))[0]
        )
        for j in range(given.joints)
    ]
    gain = [
        given.actuator.gain[j] if j < len(given.actuator.gain) else given.actuator.gain[0]
        for j in range(given.joints)
    ]
    changed_offset = bool(given.sensor.offset)
    for j, part in enumerate(parts):
        model = part.model
        terms += own_terms(model.at(j + 1))
        for key, items in mechanism.items():
            source = model.mechanism[key]
            if len(items) > 1:
                items[j] = source[j]
            elif len(parts) == 1:
                items[0] = source[0]
        if model.sensor.offset:
            offset[j] = (
                model.sensor.offset[j] if j < len(model.sensor.offset) else model.sensor.offset[0]
            )
            changed_offset = True
        gain[j] = model.actuator.gain[j] if j < len(model.actuator.gain) else model.actuator.gain[0]
    return replace(
        given,
        terms=tuple(terms),
        mechanism={key: tuple(items) for key, items in mechanism.items()},
        sensor=replace(given.sensor, offset=tuple(offset)) if changed_offset else given.sensor,
        actuator=(
            replace(given.actuator, gain=tuple(gain))
            if len(set(gain)) > 1
            or (len(given.actuator.gain) == 1 and gain[0] != given.actuator.gain[0])
            else given.actuator
        ),
    )


def calibrated_machine(train: Data, given: Model, bases: Sequence[Scored], jobs: int) -> Model:
    """The calibrated model of the whole machine from those of its joints, in their order. Shared
    parameters are fitted to all joints.
    """
    start = merge(given, bases)
    if not shared_mechanism(given):
        return start
    data = replace(train, bandwidth=tuple(b.data.bandwidth[j] for j, b in enumerate(bases)))
    everything = tuple(range(1, given.joints + 1))
    return fit(data, start, free_handles(start), joints=everything, jobs=jobs, iterations=10).model


def with_lasting_torque(data: Data, fitted: Fit, joints: Sequence[int]) -> Fit:
    """The fit with its standard deviations over longer blocks of time, where those are larger. A
    random torque may last longer than the blocks of a fit.
    """
    rows = sum(rec[j - 1].n for rec in data.records for j in joints)
    most = rows // (BLOCKS_A_NUMBER * max(len(fitted.handles), 1))
    block = min(round(LASTING / data.records[0][0].sample_time), most)
    if not fitted.handles or block <= block_count(data):
        return fitted
    jacobian, r = fitted.jacobian, fitted.residual
    prior = np.abs(jacobian[rows:]).sum(axis=0)  # a row for each number that has one
    longer = robust_covariance(jacobian[:rows], r[:rows], block, prior)
    known = np.maximum(np.diag(fitted.covariance), 1e-300)
    grow = np.sqrt(np.maximum(np.diag(longer) / known, 1.0))
    return replace(fitted, covariance=fitted.covariance * np.outer(grow, grow))


def with_disagreement(
    data: Data, held: Data, fitted: Fit, joints: Sequence[int], jobs: int
) -> Fit:
    """The fit with the disagreement of held-out recordings added to its covariance: half of the
    squared difference of the numbers beyond the uncertainty of both. This is the variance between
    two groups of a random-effects model (DerSimonian and Laird 1986). Only a sure difference
    counts, since held-out recordings may hardly determine a number.
    """
    if not fitted.handles:
        return fitted
    others = replace(data, records=held.records).within_limits_of(data)
    other = fit(
        others, fitted.model, fitted.handles, joints=joints, jobs=jobs, start=fitted.x, iterations=6
    )
    angle = np.array([h.key in ("phase", "angle") for h in fitted.handles])
    apart = other.x - fitted.x
    apart = np.where(angle, np.remainder(apart + np.pi, 2 * np.pi) - np.pi, apart)
    beyond = 0.5 * np.maximum(apart**2 - SURE**2 * (fitted.std**2 + other.std**2), 0.0)
    return replace(fitted, covariance=fitted.covariance + np.diag(beyond))


def with_slower_observer(data: Data, fitted: Fit, joint: int, jobs: int) -> Fit:
    """The fit with the disagreement of an observer half as fast added to its covariance: the
    squared difference of the numbers beyond the uncertainty of both (Hausman 1978). For a right
    model any observer finds the same numbers. An unseen oscillation behind a coarse sensor shifts
    them differently for each observer.
    """
    slow = data.at_bandwidth(joint, 0.5 * data.bandwidth[joint - 1])
    other = fit(
        slow, fitted.model, fitted.handles, joints=(joint,), jobs=jobs, start=fitted.x, iterations=6
    )
    apart = (other.x - fitted.x) ** 2 - fitted.std**2 - other.std**2
    return replace(fitted, covariance=fitted.covariance + np.diag(np.maximum(apart, 0.0)))


def _beside_other_springs(searches: Sequence[Decision], agreed: dict[int, Fit]) -> dict[int, Fit]:
    """The fits, where several joints claim a transmission with a wider stiffness: each joint feels
    what is known of the other's link, which no block of time shows.
    """
    joints = [s.joint for s in searches if any(c.is_transmission for c in s.claims)]
    if len(joints) < 2:
        return agreed
    wider = {}
    for joint in joints:
        fitted = agreed[joint]
        stiff = np.array([h.key == "stiffness" for h in fitted.handles])
        shift = SPRINGS_SHIFT * stiff * fitted.x
        wider[joint] = replace(fitted, covariance=fitted.covariance + np.diag(np.square(shift)))
    return {**agreed, **wider}


def beside_given_gravity(given: Model, joint: int, fitted: Fit) -> Fit:
    """A gravity found beside the model's own, converted to act beside the given number, which is
    known to TOLERANCE. G sin q + A sin(q - φ) is the same torque for any G with suitable A and φ.
    """
    items = given.mechanism["gravity"]
    k = joint - 1 if len(items) > 1 else 0
    at_joint = [(t.effect, t.joint) for t in fitted.model.terms]
    row = at_joint.index(("gravity", joint))
    places = [("mechanism", k, "gravity"), ("term", row, "torque"), ("term", row, "angle")]
    names = [(h.place, h.index, h.key) for h in fitted.handles]
    if not all(place in names for place in places):
        return fitted
    at = [names.index(place) for place in places]
    free, size, angle = fitted.x[at]
    known = items[k].value
    level = np.array([free - known + size * np.cos(angle), size * np.sin(angle)])
    by = np.array(
        [[1.0, np.cos(angle), -size * np.sin(angle)], [0.0, np.sin(angle), size * np.cos(angle)]]
    )
    whole = float(np.hypot(*level))
    into = np.array([level / whole, [-level[1] / whole**2, level[0] / whole**2]])
    turn = np.eye(len(names))
    turn[np.ix_(at, at)] = np.vstack([np.zeros(3), into @ by])
    spread = turn @ fitted.covariance @ turn.T
    spread[np.ix_(at[1:], at[1:])] += (TOLERANCE * known) ** 2 * np.outer(into[:, 0], into[:, 0])
    x = fitted.x.copy()
    x[at] = known, whole, np.arctan2(level[1], level[0])
    model = set_values(fitted.model, fitted.handles, x)
    return replace(fitted, model=model, x=x, covariance=spread)


def assemble(parts: Parts, given: Model, searches: Sequence[Decision], jobs: int) -> Assembled:
    """Both models of the whole machine; parameters that joints share are refitted on all of them at
    once.
    """
    train, held = parts.fit, parts.held
    bandwidth = tuple(s.final.data.bandwidth[s.joint - 1] for s in searches)
    data = replace(train, bandwidth=bandwidth)
    if not shared_mechanism(given):
        calibrated = merge(given, [s.base for s in searches])
        certain = {s.joint: _certain(s.final.data, s.final.fit, (s.joint,)) for s in searches}
        agreed = {
            s.joint: with_disagreement(s.final.data, held, certain[s.joint], (s.joint,), jobs)
            for s in searches
            if s.claims
        }
        for s in searches:
            if any(c.is_transmission for c in s.claims):
                told = agreed[s.joint]
                agreed[s.joint] = with_slower_observer(s.final.data, told, s.joint, jobs)
        agreed = _beside_other_springs(searches, {**certain, **agreed})
        for s in searches:
            if given.mechanism.get("gravity") and any(c.effect == "gravity" for c in s.claims):
                for fits in (certain, agreed):
                    fits[s.joint] = beside_given_gravity(given, s.joint, fits[s.joint])
        improved = merge(given, [replace(s.final, fit=agreed[s.joint]) for s in searches])
        return Assembled(
            _noted(calibrated, {s.joint: s.base.fit for s in searches}),
            _noted(improved, agreed),
            certain,
            agreed,
            data,
        )
    everything = tuple(range(1, given.joints + 1))
    calibrated = calibrated_machine(train, given, [s.base for s in searches], jobs)
    start = _with_shared(merge(given, [s.final for s in searches]), [s.final for s in searches])
    whole = fit(data, start, free_handles(start), joints=everything, jobs=jobs, iterations=12)
    whole = _certain(data, whole, everything)
    wider = whole
    if any(s.claims for s in searches):
        wider = with_disagreement(data, held, whole, everything, jobs)
    fits, agreed = (dict.fromkeys(everything, f) for f in (whole, wider))
    return Assembled(calibrated, _noted(whole.model, {1: wider}), fits, agreed, data)


def _certain(data: Data, fitted: Fit, joints: Sequence[int]) -> Fit:
    """The fit with all of its uncertainty that its own recordings show."""
    return with_step_error(data, with_lasting_torque(data, fitted, joints), joints)


def _with_shared(model: Model, parts: Sequence[Scored]) -> Model:
    """The model with shared parameters at the weighted mean of the joints' own fits, by their
    certainty. A common fit from elsewhere could start beside a resonance.
    """
    sums: dict[str, tuple[float, float]] = {}
    for part in parts:
        for h, value, std in zip(part.fit.handles, part.fit.x, part.fit.std, strict=True):
            if h.place == "mechanism" and len(model.mechanism[h.key]) == 1 and 0 < std < np.inf:
                total, weight = sums.get(h.key, (0.0, 0.0))
                sums[h.key] = total + float(value) / std**2, weight + float(std) ** -2
    mechanism = dict(model.mechanism)
    for key, (total, weight) in sums.items():
        mechanism[key] = (replace(mechanism[key][0], value=total / weight),)
    return replace(model, mechanism=mechanism)


def of_ratios(fitted: Fit) -> npt.NDArray[np.float64]:
    """Standard deviations of a fit (p,), those of tied numbers not as ratios."""
    out = fitted.std
    place = {(h.index, h.key): i for i, h in enumerate(fitted.handles) if h.place == "term"}
    for i, h in enumerate(fitted.handles):
        if h.tie is not None:
            weights = np.zeros(len(out))
            leader = place[h.index, LEADER]
            weights[[i, leader]] = fitted.x[leader], fitted.x[i]
            out[i] = math.sqrt(max(float(weights @ fitted.covariance @ weights), 0.0))
    return out


def _noted(model: Model, fits: dict[int, Fit]) -> Model:
    """The model with the standard deviations of the fits, including the differences between any two
    simulators.
    """
    mechanism = {key: list(items) for key, items in model.mechanism.items()}
    terms = {id(t): dict(t.parameters) for t in model.terms}
    for fitted in fits.values():
        for h, s in zip(fitted.handles, of_ratios(fitted), strict=True):
            if h.place == "mechanism":
                known = mechanism[h.key][h.index]
                mechanism[h.key][h.index] = _known_to(known, h.key, float(s))
            elif h.place == "term":
                source = fitted.model.terms[h.index]
                for t in model.terms:
                    if t is source or (
                        t.effect == source.effect
                        and t.joint == source.joint
                        and t.parameters == source.parameters
                    ):
                        old: Quantity = terms[id(t)][h.key]
                        terms[id(t)][h.key] = _known_to(old, h.key, float(s))
    return replace(
        model,
        mechanism={key: tuple(items) for key, items in mechanism.items()},
        terms=tuple(Term(t.effect, t.joint, terms[id(t)]) for t in model.terms),
    )


def _known_to(number: Quantity, name: str, std: float) -> Quantity:
    if name in ("order", "period"):  # of positions, which are measured
        return replace(number, std=std)
    size = 1.0 if name in ("phase", "angle") else abs(number.value)
    return replace(number, std=math.hypot(std, INTEGRATION_ERROR * size))
