"""The hypotheses for one joint: those that a screen can rank, and those that need a simulation with
states of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.measure.likelihood import deviance_of
from zendsp.diagnosis.search.screen import Candidate, Screen, promised, with_candidate
from zendsp.physics.calibration.fit import Data, fit, joint_handles, residuals
from zendsp.physics.calibration.joint import effective_inertia, facts
from zendsp.physics.calibration.terms import make_term, usable
from zendsp.physics.effects import Effect, get_effect, is_supported, library
from zendsp.physics.kernel.threads import threads
from zendsp.physics.model import Model, Term

COARSE = 1e-3  # s
LIVELY = 6.0  # s, or a quarter of a recording: enough for start values of a transmission
SLOWEST = 8.0  # rad/s: slowest observer of a screen
STARTS = 2  # start values of an effect that are fitted
SAME_INERTIA = 0.05  # change, as a logarithm, within which a fit of a gap still converges


def screened(
    data: Data, model: Model, joint: int, *, jobs: int = 1, only: frozenset[str] = frozenset()
) -> list[tuple[float, Candidate]]:
    """Candidates with the share of the cost that each promises to remove, best first.

    The screen has a slower observer than the data, which sees what a fast one follows.

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
    around = data.thinned().at_bandwidth(joint, max(SLOWEST, here / 4) if here > SLOWEST else here)
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
    """Whether a free parameter of the given model has the same effect."""
    if model.called is not None and (effect, joint) in model.called.does:
        return True
    items = [model.mechanism.get(key, ()) for key in get_effect(effect).same_as]
    return any(values[min(joint, len(values)) - 1].free for values in items if values)


def starts_of(candidate: Candidate, data: Data) -> list[Candidate]:
    """A screened hypothesis, and the same from another start where its effect defines one."""
    effect = get_effect(candidate.effect)
    if effect.restart is None or len(candidate.terms) != 1:
        return [candidate]
    record = max((rec[candidate.joint - 1] for rec in data.records), key=lambda r: r.n)
    values = {name: q.value for name, q in candidate.terms[0].parameters.items()}
    other = make_term(effect, candidate.joint, dict(effect.restart(facts(record), values)))
    return [candidate, replace(candidate, terms=(other,))]


def loosened(
    model: Model, joint: int, only: frozenset[str] = frozenset()
) -> list[list[Candidate]]:
    """Hypotheses that free the numbers of the model's fixed terms: a law may be right and its
    number wrong.

    Numbers with a standard deviation, held by an earlier diagnosis, stay; and so does a creep,
    which is no law: the search itself holds one.
    """
    terms = model.at(joint)
    names = [t.effect for t in terms]
    out = []
    for term in terms:
        effect = get_effect(term.effect)
        fitted = [p.name for p in effect.parameters if p.fitted and p.name in term.parameters]
        numbers = [term.parameters[name] for name in fitted]
        fixed = any(not q.free and q.std == 0.0 for q in numbers)
        if not fixed or term.effect == "creep" or names.count(term.effect) > 1:
            continue
        if only and term.effect not in only:
            continue
        free = replace(
            term,
            parameters={k: replace(q, free=k in fitted) for k, q in term.parameters.items()},
        )
        out.append([Candidate(term.effect, joint, (free,), (term.effect,), math.nan)])
    return out


def simulated(
    data: Data,
    model: Model,
    joint: int,
    only: frozenset[str] = frozenset(),
    jobs: int = 1,
    given: Model | None = None,
) -> list[list[Candidate]]:
    """Hypotheses that no column can screen, each with its start values; ``jobs`` threads.

    A transmission also starts from the numbers of the ``given`` model, since those calibrated
    without it absorb a good part of it. Beneath a weight that calibration had bent by 14 %, every
    start of the true spring was worse than none; beneath the given one it was the best of all. A
    gap, whose starts are costly, does so only where calibration bent the inertia.
    """
    record = max((rec[joint - 1] for rec in data.records), key=lambda r: r.n)
    present = {t.effect for t in model.at(joint)}
    out = []
    for effect in library().values():
        if effect.scan is None or effect.name in present or (only and effect.name not in only):
            continue
        if not is_supported(effect, present) or not usable(
            effect, [rec[joint - 1] for rec in data.records]
        ):
            continue
        kin = {
            name
            for name in present
            if get_effect(name).sole and get_effect(name).family == effect.family
        }
        had = {t.effect for t in given.at(joint)} if given is not None else set()
        others = kin - {*effect.replaces, *effect.instead_of}
        if effect.sole and others - had:  # an effect found already stays
            continue
        beneath = [model]
        if effect.family == "transmission" and given is not None:
            before = as_given(model, given)
            change = float(np.mean(effective_inertia(record, before))) / float(
                np.mean(effective_inertia(record, model))
            )
            if not effect.rough or abs(math.log(change)) > SAME_INERTIA:
                beneath.append(before)
        gone = tuple(sorted(kin)) if effect.sole else ()
        starts = scan(data, beneath, joint, effect, gone, jobs=jobs)
        if starts:
            out.append(
                [
                    Candidate(
                        effect.name, joint, (term,), gone, gain, None if base is model else base
                    )
                    for term, base, gain in starts
                ]
            )
    return out


def as_given(model: Model, given: Model) -> Model:
    """The model with the numbers of the given model, for the terms of that."""
    left = list(given.terms)
    terms = []
    for term in model.terms:
        same = next((t for t in left if t.effect == term.effect and t.joint == term.joint), None)
        if same is not None:
            left.remove(same)
        terms.append(same or term)
    return replace(model, mechanism=given.mechanism, terms=tuple(terms))


def coarse(data: Data) -> Data:
    """The same recordings with integration steps of up to a millisecond, for a first fit of a
    hypothesis.
    """
    steps = [min(data.inner, math.ceil(rec[0].sample_time / COARSE - 1e-6)) for rec in data.records]
    return replace(data, inner=max(1, *steps))


def first_look(data: Data, model: Model, joint: int) -> Data:
    """The recordings for a first fit of a model: with coarse steps, and thinned where no resonance
    of a transmission needs every sample.
    """
    fast = any(get_effect(t.effect).family == "transmission" for t in model.at(joint))
    return coarse(data if fast else data.thinned())


def scan(
    data: Data,
    models: Sequence[Model],
    joint: int,
    effect: Effect,
    gone: tuple[str, ...],
    jobs: int = 1,
) -> list[tuple[Term, Model, float]]:
    """The most likely of an effect's start values, one simulation each, upon each of some models
    without the effects that are ``gone`` for it. For a transmission also the largest promised
    decrease of the deviance per sample (nan for others), and the start of a spring that promises
    it: beside calibrated numbers that are bent for want of a load, the true one is worse than none,
    and a spring so stiff that it does nothing is the most likely.
    """
    assert effect.scan is not None
    record = max((rec[joint - 1] for rec in data.records), key=lambda r: r.n)
    listed = []
    for model in models:
        imitate = (*effect.replaces, *effect.instead_of)
        old = next((t for t in model.at(joint) if t.effect in imitate), None)
        numbers = {name: q.value for name, q in old.parameters.items()} if old else {}
        listed += [
            (make_term(effect, joint, dict(values)), model)
            for values in effect.scan(facts(record, model, numbers))
        ]
    if effect.family == "transmission":
        data = coarse(data).liveliest(joint, LIVELY)
    elif not any(get_effect(t.effect).family == "transmission" for t in models[0].at(joint)):
        data = data.thinned()
    trials = [
        with_candidate(model, Candidate(effect.name, joint, (term,), gone, math.nan))
        for term, model in listed
    ]
    with threads(jobs) as each:
        columns = np.ascontiguousarray(residuals(data, trials, (joint,), each).T)
    values_of = [deviance_of(data, joint, column) for column in columns]
    gain, best = math.nan, -1
    if effect.family == "transmission" and listed:
        handles = joint_handles(data, models[0], joint)
        base = fit(data, models[0], handles, joints=(joint,), iterations=0, jobs=jobs)
        whole = np.flatnonzero(np.isfinite(values_of))
        gains = promised(base, columns[whole])
        gain = float(np.max(gains, initial=0.0))
        best = int(whole[np.argmax(gains)]) if gain > 0.0 and not effect.rough else -1
    order = sorted(range(len(listed)), key=lambda i: (values_of[i], i))
    def kind(i: int) -> float:  # starts of one kind lead to the same optimum
        if not effect.rough and len(models) > 1:
            return float(next(k for k, model in enumerate(models) if model is listed[i][1]))
        return listed[i][0].value(effect.apart, float(i))

    unlike = {kind(i): i for i in reversed(order)}
    first = [i for i in order if unlike[kind(i)] == i][:STARTS]
    first += [best] if best >= 0 and best not in first else []
    return [(*listed[i], gain) for i in first]
