"""Torsion: the difference of two sensors on the two sides of a transmission, and its causes.

torsion = load - motor = zero - lag q̇ - c T - …: a compliance c times the torque T that is
transmitted, a step with direction, a gap, an error over the angle.

The transmitted torque is that of a joint torque sensor. Without one it is that of the rigid bodies
behind the transmission, if the model has bodies; otherwise it is estimated in ``motor_side.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.effects import get_effect
from zendsp.physics.effects.base import Numbers
from zendsp.physics.kernel.signals import find_resolution, noise_beside_quantisation
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]

# Hz, of the low-pass that torsion and regressors share: a load follows its motor stiffly below
OF_BODIES = 10.0
OF_MOTOR = 32.0  # the same with the motor's own torque, where no stiffness is assumed
STILL = 0.02  # of the highest speed: below, friction and the side of a gap are not determined
RATE = 8.0  # rows kept for each period of the low-pass


@dataclass(frozen=True)
class Twist:
    """Torsion of one joint along one recording, (n,), rad or m; low-passed at ``band`` Hz where not
    0.

    ``torque``: the transmitted torque, as far as known. ``noise``: standard deviation of both
    sensors' own noise within the band.
    """

    torsion: Array
    q: Array
    qd: Array
    qdd: Array
    drive: Array
    torque: Array
    sample_time: float
    noise: float
    band: float
    kept: npt.NDArray[np.bool_]
    judging: npt.NDArray[np.bool_]  # rows that are evidence; the others only determine zeros
    blur: float  # standard deviation of qdd
    row: float  # sample time of the recording, s
    extra: dict[str, Array] = field(default_factory=dict)


def has_bodies(model: Model) -> bool:
    """Whether the model has the links behind the transmissions, not only a joint's whole inertia.
    """
    return model.kind not in ("rotary", "linear", "python")


def white(y: Array) -> float:
    """Standard deviation of a position sensor's noise, including quantisation."""
    step = find_resolution(y)
    return float(np.hypot(step / np.sqrt(12), noise_beside_quantisation(y, step)))


def twists(data: Data, model: Model, joint: int) -> list[Twist]:
    """The raw torsion of a joint (1-based) along each recording that has a ``position_load``."""
    out = []
    for rec in data.records:
        record = rec[joint - 1]
        q, qd, qdd = record.motion.states
        load = record.columns["position_load"]
        drive = held_drive(record, model, joint)
        torque = of_bodies(record, model) if has_bodies(model) else drive
        torque = record.columns.get("torque_measured", torque)
        still = STILL * float(np.quantile(np.abs(qd), 0.98))
        edge = max(2, round(0.05 / record.sample_time))
        blur = float(np.sqrt(np.median(record.motion.variances[2])))
        kept = np.abs(qd) > still
        kept[:edge] = kept[-edge:] = False
        noise = float(np.hypot(white(record.position), white(load)))
        out.append(
            Twist(
                load - record.position, q, qd, qdd, drive, torque, record.sample_time, noise, 0.0,
                kept, np.ones(record.n, bool), blur, record.sample_time,
            )
        )
    return out


def held_drive(record: JointRecord, model: Model, joint: int) -> Array:
    """Torque of the drive at each row, (n,), with the model's delay and limit: the mean of the
    commands held before and after the row.
    """
    command, dt = record.command, record.sample_time
    limit = per_joint(model.actuator.limit, joint, 0.0)
    if limit:
        command = np.clip(command, -limit, limit)
    if model.actuator.delay:
        command = retimed("delay", command, dt, {"time": model.actuator.delay})
    for term in model.at(joint):
        numbers = {name: number.value for name, number in term.parameters.items()}
        command = retimed(term.effect, command, dt, numbers)
    held = 0.5 * (command + np.r_[command[:1], command[:-1]])
    return np.asarray(per_joint(model.actuator.gain, joint, 1.0) * held)


def retimed(effect: str, command: Array, sample_time: float, numbers: Numbers) -> Array:
    """A command delayed by an effect, (n,)."""
    moved = get_effect(effect).retime
    return command if moved is None else moved(command, sample_time, numbers)


def of_bodies(record: JointRecord, model: Model) -> Array:
    """Torque of the bodies behind a transmission, (n,), N m or N."""
    inertia, bias = record.inertia_and_bias(model)
    _, _, qdd = record.motion.states
    return np.asarray(inertia * qdd + bias)


def moved(twist: Twist, lag: float) -> Twist:
    """The twist with the second sensor's column earlier by ``lag`` s."""
    motor = twist.q  # smoothed: only the shift of the load's column is wanted
    load = earlier(twist.torsion + motor, lag, twist.sample_time)
    return replace(twist, torsion=load - motor)


def earlier(column: Array, lag: float, sample_time: float) -> Array:
    """A column (n,) earlier by ``lag`` s."""
    from scipy.interpolate import CubicSpline  # takes half a second

    t = np.arange(len(column)) * sample_time
    return np.asarray(CubicSpline(t, column)(np.clip(t + lag, t[0], t[-1])))


def lowpass(twist: Twist, band: float) -> Twist:
    """The twist below ``band`` Hz, thinned, without phase shift."""
    from scipy.signal import butter, sosfiltfilt  # takes half a second

    fs = 1.0 / twist.sample_time
    band = min(band, 0.2 * fs)
    sos = butter(4, band, fs=fs, output="sos")
    step = max(1, round(fs / (RATE * band)))

    def slow(x: Array) -> Array:
        return np.asarray(sosfiltfilt(sos, x)[::step])

    torsion = sosfiltfilt(sos, twist.torsion)
    rate = np.gradient(torsion, twist.sample_time)[::step]
    direction = np.tanh(twist.qd / (STILL * max(float(np.quantile(np.abs(twist.qd), 0.98)), 1e-12)))
    return Twist(
        np.asarray(torsion[::step]),
        twist.q[::step],
        slow(twist.qd),
        slow(twist.qdd),
        slow(twist.drive),
        slow(twist.torque),
        twist.sample_time * step,
        twist.noise * float(np.sqrt(min(1.0, 2.0 * band / fs))),
        band,
        twist.kept[::step],
        twist.judging[::step],
        twist.blur,
        twist.row,
        {"direction": slow(direction), "rate": np.asarray(rate)},
    )


def joined(first: Twist, second: Twist, judging: int) -> Twist:
    """Two parts of one recording, with a common zero of their sensors; ``judging``: the part (0 or
    1) that counts as evidence.
    """

    def both(one: Array, other: Array) -> Array:
        return np.concatenate([one, other])

    return Twist(
        both(first.torsion, second.torsion),
        both(first.q, second.q),
        both(first.qd, second.qd),
        both(first.qdd, second.qdd),
        both(first.drive, second.drive),
        both(first.torque, second.torque),
        first.sample_time,
        first.noise,
        first.band,
        np.concatenate([first.kept, second.kept]),
        np.repeat([judging == 0, judging == 1], [len(first.q), len(second.q)]),
        first.blur,
        first.row,
    )


def judged(twists: Sequence[Twist], residual: Sequence[Array]) -> list[Array]:
    """The rows of a residual that count as evidence."""
    return [r[t.judging[t.kept]] for t, r in zip(twists, residual, strict=True)]
