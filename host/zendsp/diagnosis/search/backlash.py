"""The narrow optimum of a gap.

Contacts that begin and end at other instants make a rough cost with a deep valley a few percent
wide. A fit from afar ends in a local minimum. Three moves, in turn, lead on from there; each
overcomes what stops the others:

* A contact with much damping: one that bounces for ever, or sticks, gives no gradient.
* Ever slower observers: a fast one corrects the load at every sample and hides the instants when a
contact
  begins.
* Populations of models around what was found (``population``).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.measure.likelihood import (
    BETTER,
    SLOWEST,
    Scored,
    fastest,
    fitted_deviance,
    tune_bandwidth,
)
from zendsp.diagnosis.search.hypothesis import with_numbers
from zendsp.diagnosis.search.population import likeliest
from zendsp.diagnosis.search.white import is_white
from zendsp.physics.calibration.fit import Data, fit
from zendsp.physics.calibration.handles import Handle
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

LOSSY = 0.2  # of critical damping
DAMPED = (0.05, 0.5)  # of critical damping: a contact outside this range starts again at LOSSY
CLOSED = 1e-4  # of the travel: from a smaller gap no move leads to an open one
PROGRESS = 50.0  # deviance: a round that gains less has led nowhere
# standard deviations of logarithms to begin with: a basin spans a factor of three in the gap, of
# sixteen in the stiffness, 12 % in the inertia. The losses are those of a contact at critical
# damping, which goes with the root of the stiffness
SPREAD = {
    "gap": 0.25, "stiffness": 1.0, "damping": 0.6, "load_inertia": 0.15, "inertia": 0.03,
    "mass": 0.03,
}  # fmt: skip
CALIBRATED = 0.05  # of numbers that a gap moves little
NARROWER = (1.0, 0.3, 0.1)  # times these, one after the other: a start may lie in a narrow valley
# slower observers in a row without a gain, after which none gained in the cases examined
IDLE = 2


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
    for scale in NARROWER:
        if before - best.deviance < worth or is_white(best, joint):
            break
        # the faster the observer, the smoother the cost
        data, handles = best.data.at_bandwidth(joint, fastest(best.data)), best.fit.handles
        spread = _spread(handles) * scale**2
        model = likeliest(data, best.model, handles, joint, spread, PROGRESS, jobs)
        if model is best.model:
            continue
        start = _refitted(best, data, model, joint, jobs)
        best = min(best, descend(start, joint, jobs), key=lambda s: s.deviance)
    return best


def _spread(handles: Sequence[Handle]) -> Array:
    """The covariance of the logarithms of a model's numbers, (p, p)."""
    keys = [h.key for h in handles]
    root = np.diag([SPREAD.get(key, CALIBRATED) for key in keys])
    if {"damping", "stiffness"} <= {*keys}:
        root[keys.index("damping"), keys.index("stiffness")] = 0.5 * SPREAD["stiffness"]
    covariance: Array = root @ root.T
    return covariance


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
