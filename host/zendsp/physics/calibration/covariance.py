"""The covariance of a fit whose residuals are not white."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.predict import ran_away

Array = npt.NDArray[np.float64]

FEW_BLOCKS = 20  # weight of the classical variance, in blocks
UNKNOWN = 1e30  # variance of an undetermined number


def robust_covariance(jac: Array, r: Array, block: int, prior: Array | None = None) -> Array:
    """Covariance of least squares that holds when residuals are correlated within blocks
    (sandwich), (p, p).

    Where the blocks vary more than white innovations would, their variance counts. They may vary
    less, since a fast observer corrects an error in the next sample. Then their variance is
    averaged with the classical one, with the number of blocks as its weight.

    ``prior``: 1 over the standard deviation of a number known without any recording, 0 where
    unknown, (p,). Missing physics makes residuals larger, but not a sensor's zero less certain.
    """
    n, p = jac.shape
    if not p:
        return np.zeros((0, 0))
    normal, noise = jac.T @ jac, float(r @ r) / max(1, n - p)
    known = np.diag(noise * prior**2) if prior is not None else np.zeros((p, p))
    normal = normal + known
    if not np.all(np.isfinite(jac)) or ran_away(r):
        return np.diag(np.full(p, UNKNOWN))  # the prediction has diverged
    strength = np.diag(normal)
    idle = strength <= float(r @ r) / UNKNOWN  # numbers without influence
    scale = np.where(idle, 1.0, np.sqrt(strength))
    inverse = np.linalg.pinv(normal / np.outer(scale, scale), rcond=1e-13) / np.outer(scale, scale)
    classic = inverse * noise
    scores = _scores(jac, r, block)
    count = len(scores)
    spread = scores.T @ scores * count / max(1, count - p) + noise * known
    sandwich = inverse @ spread @ inverse
    white = np.maximum(np.diag(classic), 1e-300)
    blocks = np.maximum(np.diag(sandwich), 1e-6 * white)
    grow = np.sqrt(
        np.where(
            blocks < white, (count * blocks + FEW_BLOCKS * white) / (count + FEW_BLOCKS), blocks
        )
        / blocks
    )
    covariance: Array = sandwich * np.outer(grow, grow)
    covariance[idle, :], covariance[:, idle] = 0.0, 0.0
    covariance[idle, idle] = UNKNOWN
    return covariance


def _scores(jac: Array, r: Array, block: int) -> Array:
    """The gradient of each block of samples, (blocks, p); the last may be shorter."""
    whole, p = len(r) // block, jac.shape[1]
    some = whole * block
    parts = np.matmul(r[:some].reshape(whole, 1, block), jac[:some].reshape(whole, block, p))
    rest = r[some:] @ jac[some:]
    return parts[:, 0] if some == len(r) else np.concatenate([parts[:, 0], rest[None]])
