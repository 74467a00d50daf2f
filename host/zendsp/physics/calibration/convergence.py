"""The dependence of a fit on its integration step: the change of every number when the step is
halved.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.fit import Data, Fit, residual

Array = npt.NDArray[np.float64]

SECOND_ORDER = 4.0 / 3.0  # the change from one step to its half, extrapolated to step zero
UNFELT = 1e-30  # of the largest influence of any number on the innovations: less counts as none


def step_error(data: Data, fitted: Fit, joints: Sequence[int]) -> Array:
    """The error of each fitted number from the integration step, to first order, by one
    Gauss-Newton step at half the step.

    Parameters
    ----------
    data : Data
        The recordings of the fit.
    fitted : Fit
        With its Jacobian and residual.
    joints : sequence of int
        Joints whose innovations were fitted (1-based).

    Returns
    -------
    ndarray, shape (p,)
        In units of the numbers; zero where undetermined.
    """
    if not len(fitted.handles):
        return np.zeros(0)
    finer = residual(replace(data, inner=2 * data.inner), fitted.model, tuple(joints))
    rows = len(finer)  # the rows after these are those of the prior
    change = np.zeros(len(fitted.residual))
    change[:rows] = finer - fitted.residual[:rows]
    jacobian = fitted.jacobian.copy()
    jacobian[rows:] *= np.sqrt(np.mean(fitted.residual[:rows] ** 2))
    if not np.all(np.isfinite(change)):
        return np.zeros(len(fitted.handles))
    unit = np.sqrt(np.sum(jacobian**2, axis=0))
    felt = unit > UNFELT * unit.max()  # not, for example, the phase of a ripple of amplitude zero
    step = np.zeros(len(unit))
    step[felt] = np.linalg.lstsq(jacobian[:, felt] / unit[felt], -change, rcond=1e-8)[0]
    step[felt] /= unit[felt]
    return SECOND_ORDER * step


def with_step_error(data: Data, fitted: Fit, joints: Sequence[int]) -> Fit:
    """The fit with the error of the integration step added to its covariance."""
    error = step_error(data, fitted, joints)
    return replace(fitted, covariance=fitted.covariance + np.outer(error, error))
