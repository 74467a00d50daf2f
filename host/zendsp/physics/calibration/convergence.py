"""Whether a fit depends on the step of its integration: what halving the step does to every number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.fit import Data, Fit, residual

Array = npt.NDArray[np.float64]

SECOND_ORDER = 4.0 / 3.0  # the change from one step to its half, extrapolated to none
UNFELT = 1e-30  # of what the most felt number does to the innovations: less is nothing


def step_error(data: Data, fitted: Fit, joints: Sequence[int]) -> Array:
    """Error of each fitted number by the integration's step, to first order: one Gauss-Newton step
    at half the step.

    Parameters
    ----------
    data : Data
        What was fitted to.
    fitted : Fit
        With its Jacobian and residual.
    joints : sequence of int
        Joints whose innovations were fitted (1-based).

    Returns
    -------
    ndarray, shape (p,)
        Units of the numbers; zero where it cannot be told.
    """
    if not len(fitted.handles):
        return np.zeros(0)
    finer = residual(replace(data, inner=2 * data.inner), fitted.model, tuple(joints))
    rows = len(finer)  # those that follow are of what is known of numbers without any recording
    change = np.zeros(len(fitted.residual))
    change[:rows] = finer - fitted.residual[:rows]
    jacobian = fitted.jacobian.copy()
    jacobian[rows:] *= np.sqrt(np.mean(fitted.residual[:rows] ** 2))
    if not np.all(np.isfinite(change)):
        return np.zeros(len(fitted.handles))
    unit = np.sqrt(np.sum(jacobian**2, axis=0))
    felt = unit > UNFELT * unit.max()  # not the phase of a ripple of no size
    step = np.zeros(len(unit))
    step[felt] = np.linalg.lstsq(jacobian[:, felt] / unit[felt], -change, rcond=1e-8)[0]
    step[felt] /= unit[felt]
    return SECOND_ORDER * step


def with_step_error(data: Data, fitted: Fit, joints: Sequence[int]) -> Fit:
    """The fit with what the integration's step does in its covariance."""
    error = step_error(data, fitted, joints)
    return replace(fitted, covariance=fitted.covariance + np.outer(error, error))
