"""What can be wrong with the data, told in one clear sentence before physics is blamed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.reading import Signals
from zendsp.errors import RecordingError
from zendsp.physics.fit import Data
from zendsp.physics.joint import JointRecord, mechanism_value
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]

DEGREE = 180.0 / np.pi


def check_signals(signals: Sequence[Signals], model: Model) -> list[str]:
    """Look at each recording before it is smoothed; returns notes.

    Raises
    ------
    RecordingError
        Where a recording cannot be diagnosed: constant, unexcited, clipped, glued.
    """
    notes: list[str] = []
    for s in signals:
        notes += s.notes
        joints = s.position.shape[1]
        for j in range(joints):
            y, u = s.position[:, j], s.command[:, j]
            where = f"{s.name}: joint {j + 1}" if joints > 1 else s.name
            span = float(np.ptp(y))
            if span == 0:
                raise RecordingError(f"{where}: the position is constant; nothing moved, so nothing can be diagnosed")
            resolution = float(s.resolution[j])
            if resolution > 0 and span < 8 * resolution:
                raise RecordingError(f"{where}: the position spans {span / resolution:.0f} counts of the sensor; a diagnosis needs at least 8: excite the joint more")
            _glued(where, y, s)
            _clipped(where, y, resolution)
            limit = per_joint(model.actuator.limit, j + 1, 0.0)
            top = float(np.max(np.abs(u)))
            if limit > 0 and top > 1.001 * limit:
                notes.append(f"{where}: the command reaches {top:.4g}, beyond the actuator's limit of {limit:.4g}; it is clipped in the model")
            stuck = float(np.mean(np.abs(u) >= 0.999 * top)) if top > 0 else 0.0
            if limit <= 0 and stuck > 0.03 and len(np.unique(np.round(np.abs(u) / top, 6))) > 20:
                notes.append(f"{where}: the command stays at its largest value {top:.4g} for {100 * stuck:.0f} % of the time; it looks clipped and the model states no limit")
    return notes


def _glued(where: str, y: Array, s: Signals) -> None:
    step = np.diff(y)
    usual = float(np.quantile(np.abs(step), 0.999))
    k = int(np.argmax(np.abs(step)))
    before = np.median(np.abs(step[max(0, k - 20) : k])) if k else 0.0
    after = np.median(np.abs(step[k + 1 : k + 21])) if k + 1 < len(step) else 0.0
    jump = float(abs(step[k]))
    counts = 6 * float(np.max(s.resolution))
    if jump > 8 * max(usual, 1e-15) and jump > counts and jump > 20 * max(before, after, 1e-15) and jump > 0.004 * float(np.ptp(y)):
        raise RecordingError(f"{where}: the position jumps by {jump:.4g} between two samples at t = {s.time[k]:.4g} s: are two runs glued together, or were samples dropped? Give them as two files")


def _clipped(where: str, y: Array, resolution: float) -> None:
    for name, edge in (("top", float(y.max())), ("bottom", float(y.min()))):
        at = y == edge
        share = float(np.mean(at))
        starts = np.flatnonzero(np.diff(np.r_[0, at.astype(int)]) == 1)
        if share < 0.02 or len(starts) < 2:
            continue
        fast = 0
        for k in starts:
            if k >= 4:
                arriving = abs(float(y[k] - y[k - 4])) / 4
                usual = float(np.quantile(np.abs(np.diff(y)), 0.9))
                fast += arriving > max(0.5 * usual, 1.5 * resolution)
        if fast >= 2 and fast >= 0.7 * len(starts):
            raise RecordingError(f"{where}: the position is clipped at its {name} ({edge:.4g}, {100 * share:.0f} % of the time): the sensor's range was exceeded")


def check_motion(data: Data, model: Model, names: Sequence[str]) -> list[str]:
    """Look at the smoothed motion against the command: units, signs, excitation.

    Raises
    ------
    RecordingError
        Where position and command contradict the model so plainly that the data must be wrong, with the likeliest mistake.
    """
    notes: list[str] = []
    for rec, name in zip(data.records, names, strict=True):
        for record in rec:
            where = f"{name}: joint {record.joint}" if len(rec) > 1 else name
            if not np.any(record.command):
                if model.columns.get("command"):
                    raise RecordingError(f"{where}: the command is zero throughout; a machine that is not driven has no command column in [columns]")
                continue
            if float(np.ptp(record.command)) == 0:
                raise RecordingError(f"{where}: the command is constant ({record.command[0]:.4g}); a diagnosis needs an excited recording")
            _contradiction(where, record, model)
    return notes


def _regression(record: JointRecord, model: Model, torque: Array, gravity: bool) -> tuple[float, float, float]:
    """Inertia, its t value and R² of torque = inertia qdd + friction + offset, low frequencies only."""
    q, qd, qdd = record.motion.states
    width = max(3, round(0.02 / record.sample_time))
    kernel = np.ones(width) / width

    def low(v: Array) -> Array:
        return np.convolve(v, kernel, mode="same")[::width]

    inertia, bias = record.inertia_and_bias(model)
    mean = float(np.mean(inertia))
    sg = np.tanh(qd / (0.05 * record.scale.speed))
    columns = [low(inertia / mean * qdd), low(qd), low(sg), low(np.ones_like(q)), low(q)]
    if gravity:
        columns += [low(np.sin(q)), low(np.cos(q))]
    a = np.stack(columns, axis=1)
    y = low(torque - bias)
    scale = np.linalg.norm(a, axis=0)
    scale[scale == 0] = 1
    theta, *_ = np.linalg.lstsq(a / scale, y, rcond=1e-10)
    left = y - a / scale @ theta
    spread = float(np.sum((y - y.mean()) ** 2))
    r2 = 1 - float(left @ left) / max(spread, 1e-300)
    covariance = np.linalg.pinv((a / scale).T @ (a / scale)) * float(left @ left) / max(1, len(y) - a.shape[1])
    value = float(theta[0] / scale[0])
    error = float(np.sqrt(max(covariance[0, 0], 1e-300)) / scale[0])
    return value, value / max(error, 1e-300), r2


def _contradiction(where: str, record: JointRecord, model: Model) -> None:
    gain = per_joint(model.actuator.gain, record.joint, 1.0)
    torque = gain * record.command
    gravity = mechanism_value(model, "gravity", record.joint) != 0
    stated = float(np.mean(record.inertia_and_bias(model)[0])) + sum(t.value("amount") for t in model.at(record.joint) if t.effect == "inertia")
    value, t, r2 = _regression(record, model, torque, gravity)
    moving = float(np.std(record.motion.states[2])) * stated / max(float(np.std(torque)), 1e-300)
    ratio = value / stated
    if t < -20 and r2 > 0.6 and ratio < -0.2 and moving > 0.05:
        raise RecordingError(f"{where}: the joint accelerates against its command (apparent inertia {value:.3g}, the model says {stated:.3g}): the sign of the command or of the position is flipped")
    if t > 20 and r2 > 0.6:
        for factor, words in ((DEGREE, "the position is in radians but scaled down, or the command is in other units"), (1 / DEGREE, "the position is in degrees, not radians")):
            if 0.6 < ratio / factor < 1.6:
                raise RecordingError(f"{where}: the apparent inertia is {value:.3g}, {ratio:.3g} times the model's {stated:.3g}, a factor of 180/pi: {words}")
        for factor in (1e3, 1e-3):
            if 0.6 < ratio / factor < 1.6:
                raise RecordingError(f"{where}: the apparent inertia is {value:.3g}, {ratio:.3g} times the model's {stated:.3g}, a factor of 1000: position or command is in milli-units")
    if r2 < 0.5 and _swapped(record, stated, gain):
        raise RecordingError(f"{where}: the command column moves like a position and the position column like a torque: the two are swapped")


def _swapped(record: JointRecord, stated: float, gain: float) -> bool:
    """Whether the second derivative of the 'command' explains the 'position' with about the stated inertia."""
    width = max(3, round(0.02 / record.sample_time))
    kernel = np.ones(width) / width
    y = np.convolve(record.command, kernel, mode="same")
    velocity = np.gradient(y, record.sample_time)
    acceleration = np.gradient(np.convolve(velocity, kernel, mode="same"), record.sample_time)
    a = np.stack([acceleration, velocity, np.tanh(velocity / (0.05 * np.std(velocity) + 1e-300)), np.sin(y), np.ones_like(y)], axis=1)[2 * width : -2 * width : width]
    target = (gain * record.position)[2 * width : -2 * width : width]
    theta, *_ = np.linalg.lstsq(a, target, rcond=1e-10)
    left = target - a @ theta
    r2 = 1 - float(left @ left) / max(float(np.sum((target - target.mean()) ** 2)), 1e-300)
    return r2 > 0.8 and 0.1 < theta[0] / stated < 10


def check_excitation(data: Data) -> list[str]:
    """Notes on joints that hardly move: what cannot be told from them."""
    notes = []
    for j in range(1, data.joints + 1):
        records = [rec[j - 1] for rec in data.records]
        reversals = sum(int(np.sum(np.diff(np.sign(r.motion.states[1])) != 0)) for r in records)
        if reversals == 0:
            notes.append(f"joint {j} never reverses: Coulomb friction, offset and asymmetry cannot be told apart")
    return notes
