"""The hypotheses for one joint: what a screen can rank, and what only a simulation with its own states can judge."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.score import deviances
from zendsp.diagnosis.screen import Candidate, Screen, make_term
from zendsp.physics.effects import Effect, get_effect, library
from zendsp.physics.fit import Data, fit, joint_handles
from zendsp.physics.joint import JointRecord, effective_inertia
from zendsp.physics.model import Model, Term

COARSE = 1e-3  # s
SAME_INERTIA = 0.05  # change, as a logarithm, that is within the basin of a gap
DRY = ("coulomb", "coulomb_asymmetry", "stribeck", "load_friction", "position_friction")


def screened(
    data: Data, model: Model, joint: int, *, jobs: int = 1, only: frozenset[str] = frozenset()
) -> list[tuple[float, Candidate]]:
    """Candidates with the share of the cost that each promises to remove, best first.

    Screened with a slower observer than that of the data: it sees what a fast one follows.

    Parameters
    ----------
    data : Data
        Tuned to the model.
    model : Model
        Calibrated.
    joint : int
        1-based.
    jobs : int
        Threads.
    only : frozenset of str
        Names of the effects to try; empty: all.

    Returns
    -------
    list of (float, Candidate)
    """
    handles = joint_handles(data, model, joint)
    here = data.bandwidth[joint - 1]
    best: dict[object, tuple[float, Candidate]] = {}
    around = data.at_bandwidth(joint, max(8.0, here / 4) if here > 8.0 else here)
    result = fit(around, model, handles, joints=(joint,), iterations=3, jobs=jobs)
    for candidate in Screen(around, result, joint, (joint,)).candidates(only, jobs):
        if _absorbed(candidate.effect, model, joint):
            continue
        share = candidate.gain / max(result.cost, 1e-300)
        key = (
            candidate.effect,
            candidate.terms[0].value("law", -1.0),
            candidate.terms[0].value("from_joint", -1.0),
        )
        if key not in best or share > best[key][0]:
            best[key] = (share, candidate)
    return sorted(best.values(), key=lambda item: -item[0])


def _absorbed(effect: str, model: Model, joint: int) -> bool:
    """Whether a free parameter of the given model is the same thing."""
    if effect == "inertia":
        key = {"rotary": "inertia", "linear": "mass"}.get(model.kind, "")
        items = model.mechanism.get(key, ())
        return bool(items) and items[min(joint, len(items)) - 1].free
    return False


def starts_of(candidate: Candidate, data: Data) -> list[Candidate]:
    """A screened hypothesis; of a spring also one with its neutral point in the middle of the motion, or at its edge where it was far outside.

    What screens as a weak spring with a distant neutral point may be a strong one with a near one: a constant torque and a stiffness lie in
    one narrow valley, along which a fit hardly moves.
    """
    power = {"stiffness": 1, "cubic_stiffness": 3}.get(candidate.effect)
    if power is None or len(candidate.terms) != 1:
        return [candidate]
    term = candidate.terms[0]
    record = max((rec[candidate.joint - 1] for rec in data.records), key=lambda r: r.n)
    position = record.motion.states[0]
    centre, reach = 0.5 * float(position.max() + position.min()), 0.5 * float(np.ptp(position))
    away = term.value("neutral") - centre
    far = abs(away) > reach
    near = {
        "neutral": centre + (math.copysign(reach, away) if far else 0.0),
        "coefficient": term.value("coefficient") * (abs(away) / reach + (0.0 if far else 1.0)) ** power,
    }
    return [candidate, replace(candidate, terms=(make_term(get_effect(candidate.effect), candidate.joint, near),))]


def simulated(
    data: Data, model: Model, joint: int, only: frozenset[str] = frozenset(), jobs: int = 1, given: Model | None = None
) -> list[list[Candidate]]:
    """Hypotheses with states of their own, each with its start values; ``jobs`` threads.

    A gap is also begun from the numbers of the ``given`` model: calibrated without it, an inertia takes a good part of the gap upon itself.
    """
    record = max((rec[joint - 1] for rec in data.records), key=lambda r: r.n)
    present = {t.effect for t in model.at(joint)}
    out = []
    for effect in library().values():
        if not effect.starts or effect.name in ("lag", "delay") or effect.name in present:
            continue
        if only and effect.name not in only:
            continue
        if effect.family == "transmission" and present & {"elasticity", "backlash"}:
            continue
        if effect.name == "presliding" and not present & set(DRY):
            continue
        beneath = [model]
        if effect.name == "backlash" and given is not None:
            before = as_given(model, given)
            change = float(np.mean(effective_inertia(record, before))) / float(np.mean(effective_inertia(record, model)))
            if abs(math.log(change)) > SAME_INERTIA:
                beneath.append(before)
        starts = scan(data, beneath, joint, effect, record, jobs=jobs)
        if starts:
            out.append([Candidate(effect.name, joint, (term,), (), math.nan, None if base is model else base) for term, base in starts])
    return out


def as_given(model: Model, given: Model) -> Model:
    """The model with the numbers that the given model had, where it had them."""
    left = list(given.terms)
    terms = []
    for term in model.terms:
        same = next((t for t in left if t.effect == term.effect and t.joint == term.joint), None)
        if same is not None:
            left.remove(same)
        terms.append(same or term)
    return replace(model, mechanism=given.mechanism, terms=tuple(terms))


SCANS: dict[
    str, dict[str, tuple[float, ...]]
] = {  # resonance as frequency in Hz, gap and deflection as a share of the span, the rest as a share of the scale
    # while the gap is open the motor's inertia alone is moved: a basin spans a factor of three in the gap, of sixteen in the stiffness, 12 % in that
    "elasticity": {"stiffness": (4.0, 8.0, 15.0, 30.0, 60.0), "load_inertia": (0.2, 0.45, 0.75)},
    "backlash": {
        "gap": (0.001, 0.0025, 0.006, 0.015, 0.04),
        "stiffness": (35.0,),
        "load_inertia": tuple(1.0 - 0.92 * 0.9**i for i in range(16)),
    },
    "presliding": {"stiffness": (10.0, 30.0, 100.0, 300.0, 1000.0)},
    "hysteresis": {"force": (0.05, 0.15, 0.5), "stiffness": (3.0, 10.0, 30.0, 100.0, 300.0)},
}


def coarse(data: Data) -> Data:
    """The same recordings with integration steps of up to a millisecond, for a first look at a hypothesis."""
    steps = [min(data.inner, math.ceil(rec[0].sample_time / COARSE - 1e-6)) for rec in data.records]
    return replace(data, inner=max(1, *steps))


def scan(
    data: Data, models: Sequence[Model], joint: int, effect: Effect, record: JointRecord, keep: int = 2, jobs: int = 1
) -> list[tuple[Term, Model]]:
    """The most likely start values on a coarse grid, one simulation each, beneath them any of some models as they stand."""
    if effect.name not in SCANS:
        return [(term, models[0]) for term in starts(effect, joint, record, models[0])]
    listed = [(term, model) for model in models for term in _grid(model, joint, effect, record)]
    if effect.name == "backlash":
        data = coarse(data)
    values_of = deviances(data, [model.with_terms((*model.terms, term)) for term, model in listed], joint, jobs)
    order = sorted(range(len(listed)), key=lambda i: (values_of[i], i))
    unlike = {listed[i][0].value("gap", float(i)): i for i in reversed(order)}  # of one gap the likeliest: others lead to the same optimum
    return [listed[i] for i in order if unlike.get(listed[i][0].value("gap", float(i))) == i][:keep]


def _grid(model: Model, joint: int, effect: Effect, record: JointRecord) -> Iterable[Term]:
    """A term for each point of the grid of an effect, in SI units."""
    grid, s = SCANS[effect.name], record.scale
    inertia = float(np.mean(effective_inertia(record, model)))
    dry = sum(t.value("level") for t in model.at(joint) if t.effect == "coulomb") or 0.2 * s.torque
    for numbers in itertools.product(*grid.values()):
        point = dict(zip(grid, numbers, strict=True))
        values = {}
        share = point.get("load_inertia", 0.5)
        for name, number in point.items():
            if name == "stiffness" and "load_inertia" in grid:
                values[name] = (2 * np.pi * number) ** 2 * inertia * share * (1 - share)
            elif name == "stiffness":
                force = dry if effect.name == "presliding" else point["force"] * s.torque
                values[name] = number * force / s.position
            elif name == "gap":
                values[name] = number * s.position
            elif name == "load_inertia":
                values[name] = share * inertia
            else:
                values[name] = number * s.of(effect.parameter(name).size)
        if "load_inertia" in grid:  # a gap is found from a lossy contact: a bouncing one has no gradient to follow
            values["damping"] = (0.1 if effect.name == "elasticity" else 0.8) * math.sqrt(values["stiffness"] * values["load_inertia"])
        if effect.name == "presliding":
            values["damping"] = 0.1 * math.sqrt(values["stiffness"] * inertia)
        yield make_term(effect, joint, values)


def starts(effect: Effect, joint: int, record: JointRecord, model: Model) -> Iterable[Term]:
    """Start values in SI units: resonances are given as -frequency in Hz, gaps as a share of the span, the rest in scales."""
    s = record.scale
    inertia = float(np.mean(effective_inertia(record, model)))
    for start in effect.starts:
        values = {}
        for name, number in start.items():
            if name == "stiffness" and number < 0:
                values[name] = (2 * np.pi * -number) ** 2 * inertia * 0.24
            else:
                values[name] = number * s.of(effect.parameter(name).size)
        yield make_term(effect, joint, values)
