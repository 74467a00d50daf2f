"""The narrow optimum of a gap.

Contacts that begin and end at other instants make a rough cost with a deep valley a few percent
wide. A fit from afar ends in a local minimum. Three moves, in turn, lead on from there; each
overcomes what stops the others:

* A contact with much damping: one that bounces for ever, or sticks, gives no gradient.
* Ever slower observers: a fast one corrects the load at every sample and hides the instants when a
contact
  begins.
* A coarse grid of gaps and stiffnesses around what was found.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping

from zendsp.diagnosis.measure.likelihood import (
    BETTER,
    SLOWEST,
    Scored,
    deviances,
    fitted_deviance,
    tune_bandwidth,
)
from zendsp.diagnosis.search.hypothesis import with_numbers
from zendsp.physics.calibration.fit import Data, fit
from zendsp.physics.kernel.threads import threads
from zendsp.physics.model import Model

LOSSY = 0.2  # of critical damping
DAMPED = (0.05, 0.5)  # of critical damping: a contact outside this range starts again at LOSSY
CLOSED = 1e-4  # of the travel: from a smaller gap no move leads to an open one
GAP_ROUNDS = 3
PROGRESS = 50.0  # deviance: a round that gains less has led nowhere
GAPS = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1, 1.15, 1.2)
STIFFNESSES = (0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0)
LOSSES = (0.15, 1.0)  # of critical damping; metal on metal has a fiftieth
# slower observers in a row without a gain, after which none gained in the cases examined
IDLE = 2
TRIED = 3  # grid points that are fitted


def refine(scored: Scored, joint: int, before: float, worth: float, jobs: int) -> Scored:
    """The likeliest backlash that the moves lead to.

    Parameters
    ----------
    scored : Scored
        A fitted model with backlash at the joint.
    joint : int
        1-based.
    before : float
        Deviance of the model without it.
    worth : float
        Gain over ``before`` below which one round is enough.
    jobs : int
        Threads.
    """
    travel = max(rec[joint - 1].scale.position for rec in scored.data.records)
    if _values(scored.model, joint)["gap"] < CLOSED * travel:
        return scored
    best = min(scored, descend(lossy(scored, joint, jobs), joint, jobs), key=lambda s: s.deviance)
    for _ in range(GAP_ROUNDS):
        if before - best.deviance < worth:
            break
        softer = lossy(best, joint, jobs)
        moved = [*([softer] if softer is not best else []), *around(best, joint, jobs)]
        start = min(moved, key=lambda s: s.deviance)
        if not start.deviance < best.deviance - PROGRESS:
            break
        best = min(start, descend(start, joint, jobs), key=lambda s: s.deviance)
    return best


def lossy(scored: Scored, joint: int, jobs: int) -> Scored:
    """A fit from a contact with a fifth of critical damping; unchanged where it has about that
    already.
    """
    values = _values(scored.model, joint)
    damping = _moderate(values)
    if damping == values.get("damping", 0.0):
        return scored
    model = with_numbers(scored.model, "backlash", joint, {"damping": damping})
    return _refitted(scored, scored.data, model, joint, jobs)


def descend(scored: Scored, joint: int, jobs: int) -> Scored:
    """Fits with ever slower observers, then with central differences at the likeliest."""
    best, model, idle = scored, scored.model, 0
    bandwidth = scored.data.bandwidth[joint - 1]
    while bandwidth / 2 >= SLOWEST and idle < IDLE:
        bandwidth /= 2
        slow = _refitted(scored, scored.data.at_bandwidth(joint, bandwidth), model, joint, jobs)
        model = slow.model
        data, value = tune_bandwidth(slow.data, model, (joint,), known=slow.deviance)
        idle += 1
        if value < best.deviance:
            best, idle = Scored(slow.fit, data, value, (joint,)), 0
    for _ in range(2):
        result = fit(
            best.data,
            best.model,
            scored.fit.handles,
            joints=(joint,),
            iterations=6,
            jobs=jobs,
            central=True,
        )
        data, value = tune_bandwidth(best.data, result.model, (joint,))
        if not value < best.deviance - BETTER:
            break
        best = Scored(result, data, value, (joint,))
    return best


def around(scored: Scored, joint: int, jobs: int) -> list[Scored]:
    """Fits from the likeliest points of a grid of gaps and stiffnesses around what was found."""
    values = _values(scored.model, joint)
    points = [
        with_numbers(
            scored.model,
            "backlash",
            joint,
            {
                "gap": g * values["gap"],
                "stiffness": k * values["stiffness"],
                "damping": c * math.sqrt(k) * _moderate(values),
            },
        )
        for g, k, c in itertools.product(GAPS, STIFFNESSES, LOSSES)
        if (g, k, c) != (1.0, 1.0, 1.0)
    ]
    likely = deviances(scored.data, points, joint, jobs)
    order = sorted(range(len(points)), key=lambda i: likely[i])[:TRIED]
    with threads(jobs) as each:
        return list(each(lambda i: _refitted(scored, scored.data, points[i], joint, 1), order))


def _moderate(values: Mapping[str, float]) -> float:
    """A contact's damping: as found, or a fifth of critical where it is almost zero or almost
    critical.
    """
    critical, damping = math.sqrt(values["stiffness"] * values["load_inertia"]), values.get(
        "damping", 0.0
    )
    return damping if DAMPED[0] * critical < damping < DAMPED[1] * critical else LOSSY * critical


def _refitted(scored: Scored, data: Data, model: Model, joint: int, jobs: int) -> Scored:
    result = fit(
        data, model, scored.fit.handles, joints=(joint,), iterations=8, tolerance=1e-3, jobs=jobs
    )
    return Scored(result, data, fitted_deviance(data, result, (joint,)), (joint,))


def _values(model: Model, joint: int) -> dict[str, float]:
    term = next(t for t in model.at(joint) if t.effect == "backlash")
    return {name: q.value for name, q in term.parameters.items()}
