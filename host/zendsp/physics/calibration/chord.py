"""A fit by steps of one Jacobian, that of a model nearby.

A step then costs one pass of one set of numbers, in place of a Jacobian's. Where such steps do not
contract, the model is not near, and the numbers are left to ``fit``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from zendsp.physics.calibration.descent import Descent
from zendsp.physics.calibration.fit import Data, Fit, at_bounds, bounds_and_steps, residual
from zendsp.physics.calibration.handles import get_values, set_values
from zendsp.physics.model import Model

STEPS = 6  # most steps; of implants as small as recordings show, one to three are taken
# of what the step before promised: steps of a model that is near promise less. Of 75 implants at
# three complete joints two promised more; the deviance of the others was that of a fit within 0.4,
# a hundredth of the implant's at most
CONTRACTS = 0.1
# of the cost: what may be left to gain. Of an implant that calibration absorbs, more than this
# looks like something that a large one would show
LEFT = 1e-7


def fit_near(data: Data, model: Model, near: Fit, joint: int) -> Fit | None:
    """The fit of a model that is near another one, to one joint (1-based).

    Parameters
    ----------
    data : Data
        The recordings and observers of both.
    model : Model
        Start values.
    near : Fit
        Of the other model: its handles, and its Jacobian at its numbers.

    Returns
    -------
    Fit or None
        With Jacobian and covariance of the other; None where its steps do not lead to a minimum,
        or no number is free.
    """
    handles, jac = near.handles, near.jacobian
    if not handles:
        return None
    bounds = bounds_and_steps(data, model, handles)
    problem = Descent((), data.inner, model, handles, bounds, map, False)  # steps, no passes
    x = np.clip(get_values(model, handles), problem.low, problem.high)
    before, cost = np.inf, np.inf
    for _ in range(STEPS):
        r = residual(data, set_values(model, handles, x), (joint,))
        r = np.concatenate([r, (problem.prior * (x - problem.centre))[problem.held]])
        last, cost = cost, float(r @ r)
        ways, promised = problem.ways(x, r, jac)
        rate = promised / before if before < np.inf else CONTRACTS
        if not cost < last or not rate <= CONTRACTS:
            return None
        way = ways([0.0])[0] - x
        x, before = x + way, promised
        if promised * rate < LEFT * cost:
            r = r + jac @ way  # to first order: no pass for so small a step
            break
    else:
        return None
    low, high = problem.low, problem.high
    return replace(
        near, model=set_values(model, handles, x), x=x, cost=float(r @ r), residual=r,
        at_bound=at_bounds(x, low, high, handles),
    )  # fmt: skip
