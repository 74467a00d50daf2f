"""Ripple that passes too fast for the observers of the search.

A screw turn of 2.5 mm passes at 40 Hz when the carriage moves at 0.1 m/s: far above the band in
which hypotheses are fitted, and beneath friction a hundred times larger. A fast observer follows
everything slow and leaves the ripple in its innovations. At that speed friction laws hardly differ,
so only ripple is looked for. The position's zero need not return from one recording to the next
(homing), so the held-out recordings may choose the phase anew, and only the phase.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.decide.findings import Estimate, Finding, estimates, sentence
from zendsp.diagnosis.decide.thresholds import SURE
from zendsp.diagnosis.measure.discrepancy import difference, kept, lacking
from zendsp.diagnosis.measure.evidence import compare
from zendsp.diagnosis.measure.likelihood import FASTEST, Scored, deviance, informative
from zendsp.diagnosis.search.hypothesis import FineRipple, JointSearch, price
from zendsp.diagnosis.search.orders import outstanding
from zendsp.diagnosis.search.screen import Candidate, Screen, with_candidate
from zendsp.physics.calibration.fit import Data, Fit, fit, joint_handles
from zendsp.physics.calibration.handles import Handle
from zendsp.physics.effects import get_effect
from zendsp.physics.effects.axes import HARMONICS
from zendsp.physics.model import Model, Term

# rad/s: 64 Hz, above a tenth of the usual first resonance of a stiff drive train, and below its
# multiples
RIPPLE_BAND = 400.0
RIPPLE_SHARE = 0.03  # of the fast innovations' energy that a ripple has to explain
RIPPLE_GAIN = 60.0  # least deviance beyond the price, in the fit and on held-out recordings
MOST_RIPPLES = 2


def fine_ripples(train: Data, test: Data, search: JointSearch, jobs: int) -> list[FineRipple]:
    """The ripples that only a fast observer sees.

    Parameters
    ----------
    search : JointSearch
        The finished search of the joint.
    jobs : int
        Threads.

    Returns
    -------
    list of FineRipple
        Empty where the sample time allows no faster observer, or nothing passes on the held-out
        recordings.
    """
    joint, record = search.joint, train.records[0][search.joint - 1]
    band = min(RIPPLE_BAND, 0.4 / record.sample_time)
    if band < 2 * FASTEST:
        return []
    data, held = train.at_bandwidth(joint, band), test.at_bandwidth(joint, band)
    bare = _undisplaced(search)
    current = _fitted(data, bare, joint, 4, jobs)
    displaced = None  # the fit without position errors, where a claim has any
    if len(bare.terms) < len(search.final.model.terms):
        displaced = _fitted(data, search.final.model, joint, 4, jobs)
    found: list[FineRipple] = []
    while len(found) < MOST_RIPPLES:
        screen = Screen(data, current.fit, joint, (joint,))
        listed = screen.candidates(frozenset({"ripple"}))
        if peaks := _peaks(data, current.model, joint, band):
            listed.append(screen.best_of("ripple", [{"order": n} for n in peaks]))
        best = max(listed, key=lambda c: c.gain, default=None)
        least = RIPPLE_SHARE * screen.cost
        if best is None or best.gain < least or not _fast(best, record.scale.speed):
            break
        after = _fitted(data, with_candidate(current.model, best), joint, 8, jobs)
        index = len(after.model.terms) - 1
        cost = price(best.terms, informative(data, joint))
        if current.deviance - after.deviance < cost + RIPPLE_GAIN:
            break
        turned = _rephased(after, held, joint, index, jobs)
        evidence = compare(current, turned, test, joint)
        if evidence.gain < RIPPLE_GAIN or evidence.z < SURE:
            break
        # a transmission error with as many periods a turn makes such a torque
        if displaced is not None and compare(displaced, turned, test, joint).gain <= 0.0:
            break
        alone = _one_by_one(after, joint, jobs)
        if not alone and not _surely(after.fit):
            break
        found.append(_passing(search, current, after, alone))
        current = after
    return found


def _peaks(data: Data, model: Model, joint: int, band: float) -> list[float]:
    """The orders beyond the usual grid that stand out of the missing torque. Behind a gear a
    motor's poles pass at any order, not a whole number a turn.
    """
    records = [rec[joint - 1] for rec in data.records]
    if records[0].slides:  # whose grid goes further
        return []
    series = []
    for record, torque in zip(records, lacking(data, model, joint, band), strict=True):
        use, only = kept(record, band), np.zeros(record.n)
        only[use] = torque[use]
        series.append(only)
    return outstanding(records, series, max(HARMONICS, FASTEST / records[0].scale.speed))


def _undisplaced(search: JointSearch) -> Model:
    """The fit without terms that displace the position: 0.1 mm that only helped a slow observer
    shifts the phase of a ripple of period 2 mm by a third of a radian or more.
    """
    known, model = search.base.model, search.final.model
    return model.with_terms(
        tuple(
            t
            for t in model.terms
            if t.effect in {k.effect for k in known.at(t.joint)}
            or (effect := get_effect(t.effect)).over != "position"
            or effect.mechanism not in ("measurement", "transmission")
        )
    )


def _fast(candidate: Candidate, speed: float) -> bool:
    return candidate.terms[0].value("order") * speed > FASTEST


def _fitted(data: Data, model: Model, joint: int, iterations: int, jobs: int) -> Scored:
    handles = joint_handles(data, model, joint)
    result = fit(data, model, handles, joints=(joint,), iterations=iterations, jobs=jobs)
    return Scored(result, data, deviance(data, result.model, (joint,)), (joint,))


def _rephased(after: Scored, held: Data, joint: int, index: int, jobs: int) -> Scored:
    """The fitted ripple with the phase that suits the held-out recordings best."""
    term = after.model.terms[index]
    best: tuple[float, Fit] | None = None
    for phase in np.linspace(-math.pi, math.pi, 8, endpoint=False):
        values = {**term.parameters, "phase": replace(term.parameters["phase"], value=float(phase))}
        turned = Term(term.effect, term.joint, values)
        model = after.model.with_terms(
            (*after.model.terms[:index], turned, *after.model.terms[index + 1 :])
        )
        result = fit(
            held, model, (Handle("term", index, "phase"),), joints=(joint,), iterations=2, jobs=jobs
        )
        if best is None or result.cost < best[0]:
            best = result.cost, result
    assert best is not None
    return replace(after, fit=best[1])


def _surely(fitted: Fit) -> bool:
    """Whether the amplitude of the last term is surely not zero: what a fast observer leaves can
    follow a wave for a while by chance, and then no phase fits all of it.
    """
    amplitude = estimates(fitted, fitted.model.terms[-1], "rotary", "")["amplitude"]
    return amplitude.value >= SURE * amplitude.std


def _one_by_one(after: Scored, joint: int, jobs: int) -> list[Fit]:
    """Fits of amplitude and phase of the last term to each recording by itself, if its phase
    differs between them; empty if it does not.
    """
    last = len(after.model.terms) - 1
    if len(after.data.records) < 2:
        return []
    alone = []
    for records in after.data.records:
        data = replace(after.data, records=(records,))
        turned = _rephased(after, data, joint, last, jobs).model
        handles = tuple(Handle("term", last, key) for key in ("amplitude", "phase"))
        alone.append(fit(data, turned, handles, joints=(joint,), iterations=4, jobs=jobs))
    phases = [(float(f.x[1]), float(f.std[1])) for f in alone]
    apart = any(
        abs(math.remainder(a - b, 2.0 * math.pi)) > SURE * math.hypot(s, t)
        for (a, s), (b, t) in itertools.combinations(phases, 2)
    )
    return alone if apart else []


def _of_each(alone: Sequence[Fit], of_all: Estimate) -> tuple[Estimate, str]:
    """The mean amplitude of the recordings by themselves, and a sentence on it. One phase for all
    of them gives less: a mean of vectors that differ in direction.
    """
    sizes = np.array([abs(float(f.x[0])) for f in alone])
    std = math.hypot(float(np.mean([f.std[0] for f in alone])), float(np.ptp(sizes)) / 2.0)
    size = Estimate(float(sizes.mean()), std, of_all.unit)
    listed = ", ".join(f"{x:#.3g}" for x in sizes)
    return size, (
        f" Its phase differs between the recordings, which have {listed} {of_all.unit} each: one"
        f" phase for all would give {of_all.value:.3g}, as the improved model has it."
    )


def _passing(
    search: JointSearch, before: Scored, after: Scored, alone: Sequence[Fit]
) -> FineRipple:
    """The ripple that ``after`` has and ``before`` has not; ``alone``: see ``_one_by_one``."""
    term, joint = after.model.terms[-1], search.joint
    values = estimates(after.fit, term, "rotary", "")  # standard deviations have the same numbers
    noted = {
        name: replace(q, std=values[name].std) if name in values else q
        for name, q in term.parameters.items()
    }
    band = before.data.bandwidth[joint - 1]
    own = difference(before.data, before.model, after.model, joint, band) ** 2
    whole = (
        difference(before.data, search.base.model, search.final.model, joint) ** 2
        if search.steps
        else 0.0
    )
    share = own / max(own + whole, 1e-300)
    return FineRipple(Term(term.effect, joint, noted), after.fit, share, tuple(alone))


def finding_of(ripple: FineRipple, kind: str) -> Finding:
    """The finding of a fast ripple. ``kind``: "rotary" or "linear", for the units."""
    term = ripple.term
    values = estimates(ripple.fit, ripple.fit.model.terms[-1], kind, "")
    more = " Its phase holds for the position zero of these recordings."
    if ripple.alone:
        values["amplitude"], more = _of_each(ripple.alone, values["amplitude"])
    text = f"{sentence(term, values)} It passes faster than the other effects.{more}"
    return Finding(
        "ripple",
        term.joint,
        values,
        0.9,
        ripple.share,
        (),
        (),
        text,
        {},
        "position_torque",
        {"ripple": 1.0},
    )
