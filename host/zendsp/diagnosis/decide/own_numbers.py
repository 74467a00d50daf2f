"""What one recording alone has: numbers that surely are not those of the others, or another zero of
its position's sensor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.findings import Estimate, number
from zendsp.diagnosis.decide.pushes import fitted_to, these_alone
from zendsp.diagnosis.decide.thresholds import LAWFUL, PREDICTED, SURE, TOLERANCE
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.measure.likelihood import Scored, deviance, deviances, fit_scored
from zendsp.diagnosis.measure.significance import INTEGRATION_ERROR
from zendsp.physics.calibration.covariance import robust_covariance
from zendsp.physics.calibration.fit import Data, Fit, block_count, joint_handles, residual
from zendsp.physics.calibration.handles import Handle, get_values
from zendsp.physics.calibration.joint import JointRecord, mechanism_value
from zendsp.physics.effects import get_effect, unit_of
from zendsp.physics.model import Model, Term, per_joint

Array = npt.NDArray[np.float64]

# zeros that are tried over the shortest wave of a law: within a sixteenth of one the nearest of
# them is on the slope that leads to the right one
PER_WAVE = 8
DIVERGED = 1e300  # deviance of a zero with which the prediction runs away
ROUNDS = 3  # of the zero and the friction, by turns: the one hardly bends the other


@dataclass(frozen=True)
class Own:
    """A number of one recording that surely is not that of the others."""

    recording: str
    name: str
    now: Estimate
    others: Estimate

    def __str__(self) -> str:
        return f"{self.name} {number(self.now)}, the others' {number(self.others)}"


def by_recording(parts: Parts, model: Model, joint: int) -> dict[str, Data]:
    """All pieces of each recording, by its name."""
    out: dict[str, list[tuple[JointRecord, ...]]] = {}
    for part in (parts.fit, parts.held):
        for rec in part.records:
            out.setdefault(rec[joint - 1].recording, []).append(rec)
    return {name: these_alone(parts.fit, tuple(recs), model) for name, recs in out.items()}


def own_of_one(
    parts: Parts, base: Scored, given: Model, joint: int, jobs: int
) -> tuple[Own, ...]:
    """The numbers of the one recording that differs most surely from all others, each fitted alone;
    empty where none does, or there are too few recordings to tell which.
    """
    every = by_recording(parts, base.model, joint)
    if len(every) < 3:
        return ()
    fits = {name: fitted_to(data, base, joint, jobs).fit for name, data in every.items()}
    each = {name: _apart(name, fits, given, joint) for name in fits}
    name = max(each, key=lambda name: max((z for z, _ in each[name]), default=0.0))
    return tuple(own for _, own in each[name])


def between(
    recording: str, own: Fit, others: Fit, given: Model, joint: int
) -> tuple[Own, ...]:
    """The numbers of a recording that surely are not those which the others share."""
    fits = {recording: own, "": others}
    return tuple(own for _, own in _apart(recording, fits, given, joint))


def _apart(
    name: str, fits: Mapping[str, Fit], given: Model, joint: int
) -> list[tuple[float, Own]]:
    """Each number of a recording that is surely apart from the mean of the others', and by more
    than any number is known to; with the standard deviations between. Where the others scatter more
    than they should, all are as much less sure (Birge 1932).
    """
    out = []
    for label, _ in _labelled(fits[name], given):
        now, *others = (
            estimate
            for fit in (fits[name], *(f for n, f in fits.items() if n != name))
            if (estimate := _estimate(fit, label, given, joint)) is not None
        )
        if not others:
            continue
        weights = np.array([1.0 / e.std**2 for e in others])
        values = np.array([e.value for e in others])
        mean, std = float(weights @ values / weights.sum()), float(weights.sum() ** -0.5)
        chi = float(weights @ (values - mean) ** 2) / max(len(others) - 1, 1)
        birge = math.sqrt(max(1.0, chi))
        change, error = abs(now.value - mean), birge * math.hypot(now.std, std)
        if change > max(SURE * error, TOLERANCE * abs(mean)):
            of_all = Estimate(mean, birge * std, now.unit)
            out.append((change / error, Own(name, label, now, of_all)))
    return out


def _labelled(fit: Fit, given: Model) -> Iterator[tuple[str, Handle]]:
    """The numbers of a fit that the given model has too, with their names."""
    known = {(t.effect, t.joint) for t in given.terms}
    for handle in fit.handles:
        if handle.place == "mechanism":
            yield handle.key, handle
        elif handle.place == "term":
            term = fit.model.terms[handle.index]
            if (term.effect, term.joint) in known:
                yield f"{term.effect} {handle.key}", handle


def _estimate(fit: Fit, label: str, given: Model, joint: int) -> Estimate | None:
    """A number of a fit by its name; None where it was not fitted, or not determined."""
    for name, handle in _labelled(fit, given):
        if name == label:
            value = float(get_values(fit.model, [handle])[0])
            std = math.hypot(float(fit.std[fit.handles.index(handle)]), INTEGRATION_ERROR * value)
            known = 0.0 < std < math.inf
            return Estimate(value, std, _unit(fit.model, handle, joint)) if known else None
    return None


def _unit(model: Model, handle: Handle, joint: int) -> str:
    """The unit of a number of a model."""
    size = "torque" if handle.key == "gravity" else "inertia"
    if handle.place == "term":
        size = get_effect(model.terms[handle.index].effect).parameter(handle.key).size
    kind, torque = model.joint_kind(joint), model.torque_unit(joint)
    return unit_of(size, kind, model.actuator.command_unit, torque)


def of_numbers(differs: Sequence[Own]) -> tuple[str, ...]:
    """A sentence on the numbers of the one recording that has its own."""
    if not differs:
        return ()
    name, numbers = differs[0].recording, ", ".join(map(str, differs))
    return (
        f"{name} alone has other numbers: {numbers}. Another load, a warmer machine, or a law that"
        " these numbers stand for there",
    )


# --- another zero


def may_be_zeroed_elsewhere(model: Model) -> bool:
    """Whether another zero of the position's sensor would show only in laws over the position: a
    single joint without gravity. (With it each recording shows its own zero: ``check_zeros``.)
    """
    single = model.joints == 1 and model.kind in ("rotary", "linear")
    return single and not mechanism_value(model, "gravity", 1)


def other_zeros(
    every: Mapping[str, Data], found: Scored, joint: int, jobs: int
) -> dict[str, Estimate] | None:
    """By how much each of some recordings' positions are beyond those with which the laws over the
    position were found; None where that does not explain what a recording lacks below ``LAWFUL``.
    Those that lack as little anyway are not in it.
    """
    out = {}
    for name, data in every.items():
        plain = discrepancy(data, fitted_to_common(data, found, joint, jobs).model, joint)
        if plain.value < LAWFUL:
            continue
        zeroed = _with_zero(data, found, joint, jobs)
        if zeroed is None:
            return None
        left = discrepancy(data, zeroed[0], joint).value
        most = (1.0 - PREDICTED) * plain.value**2
        if left > LAWFUL or left**2 > most or abs(zeroed[1].value) < SURE * zeroed[1].std:
            return None
        out[name] = zeroed[1]
    return out


def of_zeros(
    zeros: Mapping[str, Estimate], those: str, found: Scored, joint: int
) -> tuple[str, ...]:
    """Sentences on recordings whose positions have another zero than ``those`` in which the laws
    were found.
    """
    wave = _common_wave(_laws(found.model, joint))
    more = f" (or by that and whole periods of {wave:.4g})" if wave else ""
    return tuple(
        f"{name} has its own zero of the position: its column is {number(zero)}{more} beyond that"
        f" of {those}, as the law over the position shows. Was the sensor started or homed"
        f" elsewhere? Add {-zero.value:.4g} to the column"
        for name, zero in zeros.items()
    )


def fitted_to_common(
    data: Data, found: Scored, joint: int, jobs: int, *, of_body: bool = False
) -> Scored:
    """The found model with a recording's own numbers of the body (``of_body``: only these) and of
    what every machine has; a law that was found keeps its numbers, so that it explains nothing
    else.
    """
    data = data.at_bandwidth(joint, found.data.bandwidth[joint - 1])
    handles = [h for h in _common(data, found.model, joint) if h.place != "term" or not of_body]
    return fit_scored(data, found.model, handles, (joint,), jobs=jobs)


def _common(data: Data, model: Model, joint: int) -> list[Handle]:
    return [
        h
        for h in joint_handles(data, model, joint)
        if h.place == "mechanism"
        or (h.place == "term" and get_effect(model.terms[h.index].effect).common)
    ]


def _laws(model: Model, joint: int) -> list[Term]:
    """The laws over the position itself, not over its changes."""
    terms = model.at(joint)
    return [t for t in terms if (e := get_effect(t.effect)).over == "position" and not e.hidden]


def _wave(term: Term) -> float:
    """The period of a law over the position, rad or m; 0 where it has none."""
    if "period" in term.parameters:
        return term.value("period")
    return 2.0 * math.pi / term.value("order") if "order" in term.parameters else 0.0


def _common_wave(laws: Sequence[Term]) -> float:
    """The period of the one law over the position; 0 where there is none, or are several."""
    return _wave(laws[0]) if len(laws) == 1 else 0.0


def _with_zero(
    data: Data, found: Scored, joint: int, jobs: int
) -> tuple[Model, Estimate] | None:
    """The found model, fitted to a recording with a zero of its own, and that zero."""
    laws = _laws(found.model, joint)
    if not laws:
        return None
    data = data.at_bandwidth(joint, found.data.bandwidth[joint - 1])
    record = data.records[0][joint - 1]
    reach = math.pi if not record.slides else float(np.ptp(record.position))
    reach = 0.5 * _common_wave(laws) or reach
    step = min((_wave(t) for t in laws if _wave(t)), default=reach) / PER_WAVE
    count = math.ceil(reach / step)
    model, tried = found.model, step * np.arange(-count, count + 1)
    values = deviances(data, [_moved(model, joint, z) for z in tried], joint, jobs)
    zero = float(tried[int(np.argmin(values))])
    if not min(values) < math.inf:
        return None
    for _ in range(ROUNDS):
        zero = _nearest(data, model, joint, (zero - step, zero + step))
        moved = _moved(model, joint, zero)
        own = fit_scored(data, moved, _common(data, moved, joint), (joint,), jobs=jobs)
        model, data = _moved(own.model, joint, -zero), own.data
    return own.model, _zero_of(own, -zero, step, joint)


def _nearest(data: Data, model: Model, joint: int, around: tuple[float, float]) -> float:
    """The zero between two with which the model is likeliest."""
    from scipy.optimize import minimize_scalar  # takes half a second

    def lost(zero: float) -> float:
        return min(deviance(data, _moved(model, joint, zero), (joint,)), DIVERGED)

    return float(minimize_scalar(lost, bounds=around, method="bounded").x)


def _moved(model: Model, joint: int, zero: float) -> Model:
    """The model with its sensor's zero moved."""
    offset = [per_joint(model.sensor.offset, j + 1, 0.0) for j in range(model.joints)]
    offset[joint - 1] += float(zero)
    return replace(model, sensor=replace(model.sensor, offset=tuple(offset)))


def _zero_of(own: Scored, zero: float, step: float, joint: int) -> Estimate:
    """The zero with its standard deviation beside the numbers that were fitted with it."""
    small = step / 100.0
    r = residual(own.data, own.model, (joint,))
    each = (residual(own.data, _moved(own.model, joint, way * small), (joint,)) for way in (1, -1))
    column = np.subtract(*each)[:, np.newaxis] / (2.0 * small)
    jac = np.concatenate([own.fit.jacobian[: len(r)], column], axis=1)
    variance = float(robust_covariance(jac, r, block_count(own.data))[-1, -1])
    slides = own.data.records[0][joint - 1].slides
    unit, of_simulators = ("m", zero) if slides else ("rad", 1.0)
    std = math.hypot(math.sqrt(max(variance, 0.0)), INTEGRATION_ERROR * of_simulators)
    return Estimate(zero, std, unit)
