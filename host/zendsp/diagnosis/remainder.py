"""What is left after the best explanation, and whether it is a function of state, of time, or nothing.

The observer's correction of the velocity is an estimate of the torque that the model lacks, whatever hidden states the model has. A smooth
function of position, velocity, acceleration and command is fitted to it on the recordings of the fit and judged on the held-out
ones: what such a function predicts there is physics; what it does not is noise or a disturbance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline

from zendsp.physics.fit import Data
from zendsp.physics.joint import JointRecord, effective_inertia, run
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

OBSERVER = 64.0  # rad/s: fast enough to place a torque within 20 ms, slow enough to average the quantiser


@dataclass(frozen=True)
class Remainder:
    """Torque that a model lacks at one joint.

    Attributes
    ----------
    size : float
        RMS of the torque, N m or N (held-out recordings).
    relative : float
        The same over the RMS torque of the recording.
    state_share : float
        Share of its energy that a function of state predicts on the held-out recordings.
    state_size : float
        RMS of that part, N m or N.
    time_peak : float
        Share of the energy in the tenth of the time where it is largest.
    """

    size: float
    relative: float
    state_share: float
    state_size: float
    time_peak: float


def lacking_torque(record: JointRecord, model: Model, inner: int = 2) -> Array:
    """Torque that the observer adds to keep a model on the measured motion, (n,), N m or N; shifted back by its own delay."""
    bandwidth = min(OBSERVER, 0.25 / record.sample_time)
    _, k2, w = record.gains(bandwidth)
    r = run(record, model, bandwidth, inner=inner).innovations
    inertia = effective_inertia(record, model)
    torque = np.where(w > 0, r / np.maximum(w, 1e-300), 0.0) * k2 * inertia / record.sample_time
    lag = round(np.sqrt(2) / bandwidth / record.sample_time)
    width = max(1, lag // 2)
    kernel = np.ones(width) / width
    smooth = np.convolve(torque, kernel, mode="same")
    shifted = np.r_[smooth[lag:], np.zeros(lag)]
    skip = min(record.n // 10, round(0.4 / record.sample_time))
    shifted[:skip] = 0.0
    out: Array = -shifted
    return out


def _features(records: list[JointRecord], ranges: list[tuple[float, float]], stride: int = 1) -> Array:
    rows = []
    for rec in records:
        q, qd, qdd = rec.motion.states
        rows.append(np.stack([q, qd, qdd, rec.command], axis=1))
    x = np.concatenate(rows)[::stride]
    u = [np.clip((x[:, i] - lo) / max(hi - lo, 1e-300), 0.0, 1.0 - 1e-9) for i, (lo, hi) in enumerate(ranges)]
    fine = [_splines(v, 14) for v in u]
    coarse = [_splines(v, 7) for v in u]
    products = [
        np.einsum("ni,nj->nij", coarse[a], coarse[b]).reshape(len(x), -1) for a, b in ((0, 1), (1, 3), (0, 3))
    ]
    sign = np.tanh(x[:, 1] / (0.02 * max(abs(ranges[1][0]), abs(ranges[1][1]), 1e-300)))[:, None]
    return np.concatenate([*fine, *products, sign, sign * fine[0], sign * np.abs(x[:, 3:4])], axis=1)


def _splines(u: Array, count: int) -> Array:
    degree = 3
    inner = np.linspace(0, 1, count - degree + 1)
    knots = np.r_[np.zeros(degree), inner, np.ones(degree)]
    matrix: Array = BSpline.design_matrix(u, knots, degree).toarray()
    return matrix


def remainder(train: Data, test: Data, model: Model, joint: int) -> Remainder:
    """How large the lacking torque is on the held-out recordings, and how much of it is a function of state."""
    fit_records = [rec[joint - 1] for rec in train.records]
    test_records = [rec[joint - 1] for rec in test.records]
    d_fit = np.concatenate([lacking_torque(r, model) for r in fit_records])
    d_test = np.concatenate([lacking_torque(r, model) for r in test_records])
    data = np.concatenate([np.stack([*r.motion.states, r.command], axis=1) for r in fit_records])
    ranges = [(float(np.quantile(c, 0.002)), float(np.quantile(c, 0.998))) for c in data.T]
    size = float(np.sqrt(np.mean(d_test**2)))
    scale = max(r.scale.torque for r in test_records)
    stride = max(1, len(d_fit) // 6000)
    a = _features(fit_records, ranges, stride)
    sparse = max(1, len(d_test) // 6000)
    b = _features(test_records, ranges, sparse)
    inside = np.ones(len(d_test), bool)
    offset = 0
    for r in test_records:
        x = np.stack([r.motion.states[0], r.motion.states[1]], axis=1)
        inside[offset : offset + r.n] = np.all(
            (x >= [ranges[0][0], ranges[1][0]]) & (x <= [ranges[0][1], ranges[1][1]]), axis=1
        )
        offset += r.n
    target = d_fit[::stride]
    best = (0.0, 0.0)
    gram, moment = a.T @ a, a.T @ target
    level = float(np.trace(gram)) / len(gram)
    inside = inside[::sparse]
    if inside.sum() > 50 and size > 0:
        y = d_test[::sparse][inside]
        seen = b[inside]
        for ridge in (1e-3, 1e-2, 1e-1):
            theta = np.linalg.solve(gram + ridge * level * np.eye(len(gram)), moment)
            guess = seen @ theta
            share = 1.0 - float(np.sum((y - guess) ** 2)) / max(float(np.sum(y**2)), 1e-300)
            if share > best[0]:
                best = (share, float(np.sqrt(np.mean(guess**2))))
    sorted_energy = np.sort(d_fit**2)[::-1]
    peak = float(sorted_energy[: max(1, len(sorted_energy) // 10)].sum() / max(sorted_energy.sum(), 1e-300))
    return Remainder(size, size / scale, best[0], best[1], peak)
