"""Recordings of a pendulum whose positions begin at different zeros: gravity shows where each one's
zero lies.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.data.regression import ANGLE_SPAN, PER_COLUMN, TURNS, look
from zendsp.diagnosis.data.series import repeats
from zendsp.diagnosis.measure.likelihood import Scored, calibrate_joint
from zendsp.errors import RecordingError
from zendsp.physics.calibration.fit import Data, residual
from zendsp.physics.calibration.joint import JointRecord, mechanism_value
from zendsp.physics.model import Model, Quantity, Term, per_joint

ZERO_SURE = 6.0  # standard errors of the difference of two zeros: chosen, not measured
ROUGHLY = 2.0  # standard errors by a regression, from which the zeros are estimated by fits
SAME_WEIGHT = 0.05  # of the weight: the largest difference of two recordings: chosen, not measured
OTHER_ZERO = 8.0  # counts of the sensor: a smaller difference of two zeros is none
# of the energy that one zero for both leaves: zeros of their own, 0.7 rad apart, left 2e-5 of it;
# 0.05 rad apart, 0.003
LEFT_BY_OWN = 0.1


@dataclass(frozen=True)
class _Weight:
    """Gravity in a recording: its torque, N m, and the angle at which the joint hangs, rad, with
    its standard error.
    """

    recording: str
    torque: float
    hangs: float
    error: float

    def apart(self, other: _Weight, sure: float) -> float:
        """The difference of two zeros where it is sure, rad; else 0."""
        angle = math.remainder(self.hangs - other.hangs, 2 * math.pi)
        return angle if abs(angle) > sure * math.hypot(self.error, other.error) else 0.0


_Fitted = tuple[Scored, _Weight]


def check_zeros(data: Data, model: Model) -> None:
    """Refuse recordings of one joint of which gravity says that their zeros differ.

    Raises
    ------
    RecordingError
        Names both recordings, and what to add to the column.
    """
    if model.kind != "rotary" or model.joints > 1 or not mechanism_value(model, "gravity", 1):
        return
    gain = per_joint(model.actuator.gain, 1, 1.0)
    of: dict[str, list[tuple[JointRecord, ...]]] = {}  # parts of a recording have one zero
    for rec in data.records:
        of.setdefault(rec[0].recording, []).append(rec)
    longest = (max(parts, key=lambda rec: rec[0].n)[0] for parts in of.values())
    rough = [w for record in longest if (w := _by_regression(record, gain)) is not None]
    if not any(w.apart(other, ROUGHLY) for w in rough for other in rough):
        return
    each = [_by_fit(replace(data, records=tuple(of[w.recording])), model, w) for w in rough]
    first = min(each, key=lambda one: abs(one[1].hangs))
    _, right = first
    least = OTHER_ZERO * max(record.measurement.resolution for (record,) in data.records)
    for one in each:
        _, w = one
        away = w.apart(right, ZERO_SURE)
        alike = abs(w.torque - right.torque) < SAME_WEIGHT * right.torque
        if abs(away) > least and alike and _explains(first, one, model):
            error = 2.0 * math.hypot(w.error, right.error)
            raise RecordingError(
                f"{w.recording}: by gravity, its position's zero is not that of {right.recording}:"
                f" the joint hangs {away:.3g} ± {error:.1g} rad from there. Was the sensor started"
                f" or homed elsewhere? Add {-away:.3g} to the column"
            )


def _by_regression(record: JointRecord, gain: float) -> _Weight | None:
    """Gravity by a regression of the torque; None where the joint is not driven, or hardly turns.
    """
    y = record.position
    if np.ptp(y) < ANGLE_SPAN or not np.ptp(record.command):
        return None
    noise = np.array([record.measurement.std])
    slow = look(y[None], record.command[None], record.sample_time, noise)
    q, qd, qdd, u = (x[0][~slow.at_edge[0]] for x in (slow.q, slow.qd, slow.qdd, slow.command))
    turning = np.tanh(qd / (TURNS * float(np.sqrt(np.mean(qd**2))) + 1e-300))
    columns = np.stack([np.sin(q), -np.cos(q), qdd, qd, turning, np.ones_like(q)], axis=1)
    if len(u) < PER_COLUMN * columns.shape[1]:
        return None
    theta, *_ = np.linalg.lstsq(columns, u)
    left = u - columns @ theta
    variance = float(left @ left) / (len(u) - columns.shape[1]) * repeats(left, slow.sample_time)
    spread = np.linalg.pinv(columns.T @ columns)[:2, :2] * variance
    size = max(float(np.hypot(theta[0], theta[1])), 1e-300)
    across = np.array([-theta[1], theta[0]]) / size
    error = float(np.sqrt(across @ spread @ across)) / size
    return _Weight(record.recording, gain * size, math.atan2(theta[1], theta[0]), error)


def _explains(first: _Fitted, other: _Fitted, model: Model) -> bool:
    """Whether zeros of their own are what two recordings lack: they leave a tenth of what one zero
    for both leaves. Else something is missing that only looks like another zero.
    """
    both = replace(first[0].data, records=(*first[0].data.records, *other[0].data.records))
    common, _ = _by_fit(both, model, first[1])
    left = [float(one.fit.residual @ one.fit.residual) for one, _ in (first, other)]
    with_one = [residual(one.data, common.model, (1,)) for one, _ in (first, other)]
    return sum(left) < LEFT_BY_OWN * sum(float(r @ r) for r in with_one)


def _by_fit(data: Data, model: Model, rough: _Weight) -> _Fitted:
    """The model fitted with a weight that may hang at any angle, in place of all that it has, and
    that weight.
    """
    numbers = {"torque": Quantity(abs(rough.torque)), "angle": Quantity(rough.hangs)}
    weight = Term("gravity", 1, numbers)
    mechanism = {**model.mechanism, "gravity": (Quantity(0.0, free=False),)}
    others = (t for t in model.terms if t.effect != weight.effect)
    turned = replace(model, mechanism=mechanism, terms=(*others, weight))
    scored = calibrate_joint(data, turned, 1)
    found, fit = scored.model.terms[-1], scored.fit
    at = next(i for i, h in enumerate(fit.handles) if h.key == "angle")
    error = math.sqrt(max(float(fit.covariance[at, at]), 0.0))
    return scored, _Weight(rough.recording, found.value("torque"), found.value("angle"), error)
