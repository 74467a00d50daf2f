"""Recordings of a pendulum whose positions begin at different zeros: gravity shows where each one's
zero lies.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.regression import ANGLE_SPAN, PER_COLUMN, TURNS, look
from zendsp.diagnosis.data.series import repeats
from zendsp.errors import RecordingError
from zendsp.physics.calibration.joint import JointRecord, mechanism_value
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

ERRORS = 8.0  # standard errors of the difference of two zeros: chosen, not measured
ALIKE = 3.0  # standard errors: the weight itself is the same in both recordings
COUNTS = 8.0  # of the sensor: a smaller difference of two zeros is none


@dataclass(frozen=True)
class _Weight:
    """Gravity in one recording: ``size`` in units of the command, and ``zero``, the angle at which
    the joint hangs, rad; with their standard errors.
    """

    recording: str
    size: float
    size_error: float
    zero: float
    error: float


def check_zeros(records: Sequence[JointRecord], model: Model) -> None:
    """Refuse recordings of one joint of which gravity says that their zeros differ.

    Raises
    ------
    RecordingError
        Names both recordings, and by how much.
    """
    if model.kind != "rotary" or model.joints > 1 or not mechanism_value(model, "gravity", 1):
        return
    seen = [w for record in records if (w := _weight(record)) is not None]
    if not seen:
        return
    right = min(seen, key=lambda w: abs(w.zero))
    least = COUNTS * max(record.measurement.resolution for record in records)
    for w in seen:
        apart = math.remainder(w.zero - right.zero, 2 * math.pi)
        error = math.hypot(w.error, right.error)
        heavier = abs(w.size - right.size) / math.hypot(w.size_error, right.size_error)
        if abs(apart) > max(ERRORS * error, least) and heavier < ALIKE:
            raise RecordingError(
                f"{w.recording}: by gravity, its position's zero is not that of {right.recording}:"
                f" the joint hangs at {apart:.4g} ± {2 * error:.2g} rad there. Was the sensor"
                f" started or homed elsewhere? Add {-apart:.4g} to the column"
            )


def _weight(record: JointRecord) -> _Weight | None:
    """Gravity in a recording; None where the joint is not driven, or hardly turns."""
    y = record.position
    if np.ptp(y) < ANGLE_SPAN or not np.ptp(record.command):
        return None
    noise = np.array([record.measurement.std])
    slow = look(y[None], record.command[None], record.sample_time, noise)
    q, qd, qdd, u = (x[0] for x in (slow.q, slow.qd, slow.qdd, slow.command))
    turning = np.tanh(qd / (TURNS * float(np.sqrt(np.mean(qd**2))) + 1e-300))
    columns = np.stack([np.sin(q), np.cos(q), qdd, qd, turning, np.ones_like(q)], axis=1)
    columns, u = columns[~slow.at_edge[0]], u[~slow.at_edge[0]]
    if len(u) < PER_COLUMN * columns.shape[1]:
        return None
    theta, *_ = np.linalg.lstsq(columns, u)
    left = u - columns @ theta
    variance = float(left @ left) / (len(u) - columns.shape[1]) * repeats(left, slow.sample_time)
    spread = np.linalg.pinv(columns.T @ columns)[:2, :2] * variance
    size = float(np.hypot(theta[0], theta[1]))
    along = theta[:2] / max(size, 1e-300)
    across = np.array([-along[1], along[0]])
    return _Weight(
        record.recording,
        size,
        float(np.sqrt(along @ spread @ along)),
        -math.atan2(theta[1], theta[0]),
        float(np.sqrt(across @ spread @ across)) / max(size, 1e-300),
    )
