"""Simplifies the model of a search: laws that stand for simpler ones give way to them, and
terms that the recording does not need are dropped.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.measure.evidence import compare
from zendsp.diagnosis.measure.likelihood import (
    Scored,
    cost_of,
    fit_scored,
    informative,
    tune_bandwidth,
)
from zendsp.diagnosis.measure.significance import INTEGRATION_ERROR, SIGNIFICANT, vanishes, whole
from zendsp.diagnosis.search.hypothesis import JointSearch, price
from zendsp.diagnosis.search.simpler_laws import (
    NO_WORSE,
    in_simpler_laws,
    refitted,
    straightened,
)
from zendsp.physics.calibration.convergence import step_error, with_step_error
from zendsp.physics.calibration.fit import fit, joint_handles, residual
from zendsp.physics.effects import get_effect, stands_on
from zendsp.physics.model import Model, Term

# deviance per sample, a tenth of the innovations' energy: a term that costs this much to drop stays
# without a longer fit
SIMPLER_COST = 0.1
HALVINGS = 2  # most halvings of the integration step, in the last fit of a joint


def _resolved(best: Scored, joint: int, jobs: int) -> Scored:
    """The model refitted at ever smaller steps, until halving them moves its numbers less than
    their uncertainty, or than two simulators differ.

    Otherwise a finding might only be an integration error.
    """
    if len(best.fit.residual) != len(residual(best.data, best.model, (joint,))):
        # numbers so far fitted only to thinned recordings
        best = refitted(best.data, best.model, joint, jobs, 1)
    travel = max(rec[joint - 1].scale.position for rec in best.data.records)
    for _ in range(HALVINGS):
        error, fitted = step_error(best.data, best.fit, (joint,)), best.fit
        least = [
            INTEGRATION_ERROR * whole(h.key, float(x), travel)
            for h, x in zip(fitted.handles, fitted.x, strict=True)
        ]
        ours = np.array([h.place == "term" for h in fitted.handles], bool)
        if not np.any(ours & (np.abs(error) > SIGNIFICANT * np.hypot(fitted.std, least))):
            break
        data = replace(best.data, inner=2 * best.data.inner)
        best = fit_scored(data, best.model, best.fit.handles, (joint,), jobs=jobs, rounds=1)
    return best


def simplify(found: JointSearch, n: int, jobs: int) -> tuple[Scored, tuple[str, ...]]:
    """The search without terms, given or found, that the recording no longer needs."""
    best = _resolved(straightened(found, found.final, jobs), found.joint, jobs)
    best = in_simpler_laws(found, best, n, jobs)
    dropped: list[str] = []
    added = {t.effect for s in found.steps for t in s.chosen.terms}
    while True:
        certain = with_step_error(best.data, best.fit, (found.joint,))
        for i, term in enumerate(best.model.terms):
            of_all = get_effect(term.effect).site == "body"  # all joints that carry it feel it
            known = not any(q.free for q in term.parameters.values())  # held, and so known
            if term.joint != found.joint or of_all or known or _needed_by(best.model, term):
                continue
            model = best.model.with_terms(
                tuple(t for k, t in enumerate(best.model.terms) if k != i)
            )
            if hopeless(best, model, found.joint, jobs) is not None:
                continue
            idle = term.effect in added and vanishes(certain, term)
            least = best.deviance + price((term,), n)
            trial = refitted(best.data, model, found.joint, jobs, 2, math.inf if idle else least)
            rivals = get_effect(term.effect).rivals
            if trial.deviance < least or (idle and not _runs_off(trial, rivals)):
                best = trial
                if term.effect not in added or term.effect in {
                    t.effect for t in found.base.model.at(found.joint)
                }:
                    dropped.append(term.effect)
                break
        else:
            return _released(found, best, n, jobs), tuple(dropped)


def _runs_off(trial: Scored, rivals: Sequence[str]) -> bool:
    """Whether a model that has lost a term has a number of one of that term's rivals at its bound:
    it would take up what was lost, and cannot.
    """
    fitted = zip(trial.fit.handles, trial.fit.at_bound, strict=True)
    off = {trial.model.terms[h.index].effect for h, b in fitted if b and h.place == "term"}
    return not off.isdisjoint(rivals)


def _released(found: JointSearch, best: Scored, n: int, jobs: int) -> Scored:
    """The model with numbers fitted that the search only chose from a list (an exponent), where the
    recording determines them. They add to the uncertainty of the others.
    """
    had = {t.effect for t in found.base.model.at(found.joint)}
    free = {
        id(t): {
            key
            for numbers in get_effect(t.effect).tries
            for key in numbers
            if not t.parameters[key].free
        }
        for t in best.model.at(found.joint)
        if t.effect not in had
    }
    if not any(free.values()):
        return best
    terms = tuple(
        replace(
            t,
            parameters={
                key: replace(q, free=q.free or key in free.get(id(t), ()))
                for key, q in t.parameters.items()
            },
        )
        for t in best.model.terms
    )
    other = refitted(best.data, best.model.with_terms(terms), found.joint, jobs, 2)
    names = set().union(*free.values())
    at_bound = any(
        bound and h.key in names
        for h, bound in zip(other.fit.handles, other.fit.at_bound, strict=True)
    )
    # one block in which a model loses track, as at a start from rest, tells nothing of a number
    gain = compare(best, other, best.data, found.joint).gain
    told = gain > math.log(max(n, 10))
    return other if told and not at_bound else best


def upon(first: JointSearch, base: Scored, jobs: int, both: Scored | None = None) -> JointSearch:
    """A search upon a base that has got terms from elsewhere: fitted again with them (``both``:
    where that is already done), and without terms that are no longer needed.
    """
    joint, found = first.joint, first.final
    more = base.model.terms[len(first.base.model.terms) :]
    model = found.model.with_terms((*found.model.terms, *more))
    best = both or refitted(found.data, model, joint, jobs, 4)
    further = refitted(best.data, best.model, joint, jobs, 1)  # from a start so far, 12 steps
    best = further if further.deviance < best.deviance - NO_WORSE else best
    again = replace(first, base=base, best=best)
    again.best, dropped = simplify(again, informative(best.data, joint), jobs)
    return replace(again, dropped=(*first.dropped, *dropped))


def hopeless(best: Scored, model: Model, joint: int, jobs: int) -> Scored | None:
    """A model after a short fit, where its loss is so large that a long fit would not make up for
    it; else None.
    """
    handles = joint_handles(best.data, model, joint)
    least = best.deviance + SIMPLER_COST * informative(best.data, joint)
    short = fit(
        best.data,
        model,
        handles,
        joints=(joint,),
        iterations=4,
        tolerance=1e-2,
        jobs=jobs,
        brief=True,
        goal=cost_of(best.data, joint, least),
    )
    data, value = tune_bandwidth(best.data, short.model, (joint,))
    if value <= least:
        return None
    return Scored(short, data, value, (joint,))


def _needed_by(model: Model, term: Term) -> bool:
    return any(
        stands_on(get_effect(t.effect), term.effect) for t in model.at(term.joint) if t is not term
    )
