"""Torsion: the difference of two sensors on the two sides of a transmission, and its causes.

torsion = load - motor = zero - lag q̇ - c T - …: a compliance c times the torque T that is
transmitted, a step with direction, a gap, an error over the angle. Errors of the sensor pair are
removed from each recording: its zero, a lag of one column, and, where a turn was not completed, an
eccentric disc.

The transmitted torque is that of a joint torque sensor. Without one it is that of the rigid bodies
behind the transmission, if the model has bodies; otherwise the actuator's minus that which
accelerates the motor (whose inertia is fitted too).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.series import repeats
from zendsp.diagnosis.measure.discrepancy import deviation
from zendsp.diagnosis.measure.evidence import BLOCK, Evidence
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord, effective_inertia
from zendsp.physics.effects import get_effect
from zendsp.physics.effects.base import Numbers
from zendsp.physics.kernel.signals import find_resolution, noise_beside_quantisation
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]

# Hz, of the low-pass that torsion and regressors share: a load follows its motor stiffly below
OF_BODIES = 10.0
OF_MOTOR = 32.0  # the same with the motor's own torque, where no stiffness is assumed
STILL = 0.02  # of the highest speed: below, friction and the side of a gap are not determined
GAP_CROSSED = 0.1  # of the RMS torque: range over which a gap is crossed
RATE = 8.0  # rows kept for each period of the low-pass
ORDERS = 4000  # most orders of an error over the angle that are tried
FRICTION_ROUNDS = 2  # alternating estimates of the motor's inertia and its dry friction
SHARE_STEP = 0.1  # of the joint's inertia: step of first tries of the motor's part
# of the RMS torque: levels at which parts held by a transmission's friction yield (Prandtl's model)
YIELDS = (0.15, 0.4, 1.0)
# columns of a term, and its number from their coefficients
TERMS: dict[str, tuple[float, ...]] = {
    "spring": (1.0, 0.0),
    "cubic": (1.0,),
    "gap": (1.0,),
    "step": (1.0,),
    "loop": YIELDS,
}
SHARES = tuple(SHARE_STEP * (i + 0.5) for i in range(10))


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


# --- regression


def nuisance(twist: Twist, off_centre: bool) -> Array:
    """Columns of the sensors' own errors, (n, columns) of the kept rows, orthonormal."""
    columns = [np.ones_like(twist.q), twist.qd]
    if off_centre:
        columns += [np.sin(twist.q), np.cos(twist.q)]
    matrix = np.stack(columns, axis=1)[twist.kept]
    norms = np.linalg.norm(matrix, axis=0)
    return np.asarray(np.linalg.qr(matrix / np.where(norms > 0, norms, 1.0))[0])


def gap_shape(torque: Array) -> Array:
    """The side on which a gap is closed, -1 … 1."""
    size = float(np.sqrt(np.mean(torque**2)))
    return np.asarray(np.tanh(torque / (GAP_CROSSED * max(size, 1e-300))))


def columns_of(twist: Twist, terms: Sequence[str], scale: float) -> Array:
    """Columns of some terms, (n, columns) of the kept rows.

    ``spring``: torque and its damping; ``cubic``; ``gap``; ``step`` with direction; ``loop``: what
    yields with the torque later than the spring. Errors over the angle are made by ``wave``.
    """
    made: dict[str, Callable[[], list[Array]]] = {
        "spring": lambda: [twist.torque, twist.extra.get("rate", twist.q)],
        "cubic": lambda: [twist.torque * (twist.torque / scale) ** 2],
        "gap": lambda: [gap_shape(twist.torque)],
        "step": lambda: [twist.extra.get("direction", twist.q)],
        "loop": lambda: [play(twist.torque, part * scale) for part in YIELDS],
    }
    listed = [column for term in terms for column in made[term]()]
    if not listed:
        return np.zeros((int(twist.kept.sum()), 0))
    return np.stack(listed, axis=1)[twist.kept]


def play(torque: Array, yields: float) -> Array:
    """A play operator of the torque: it follows a reversal only beyond twice ``yields``, (n,)."""
    out, at = [], 0.0
    for here in torque.tolist():  # Python floats are five times faster
        at = max(here - yields, min(here + yields, at))
        out.append(at)
    return np.array(out)


def wave(twist: Twist, order: float) -> Array:
    """Sine and cosine of an order over the angle, (n, 2) of the kept rows."""
    angle = order * twist.q[twist.kept]
    return np.stack([np.sin(angle), np.cos(angle)], axis=1)


@dataclass(frozen=True)
class Linear:
    """A least-squares fit: coefficients with their covariance, and the residual of each recording.
    """

    x: Array
    covariance: Array
    residual: list[Array]


def numbers_of(terms: Sequence[str], fit: Linear, scale: float) -> dict[str, tuple[float, float]]:
    """The numbers of some terms with standard deviations: compliance at large torques, half a gap,
    half the width of a hysteresis at zero torque.
    """
    at = np.cumsum([0, *(len(TERMS[t]) for t in terms)])
    out = {}
    for term, begin in zip(terms, at[:-1], strict=True):
        weights = np.zeros(len(fit.x))
        weights[begin : begin + len(TERMS[term])] = np.array(TERMS[term]) * (
            scale if term == "loop" else 1.0
        )
        if term == "spring" and "loop" in terms:  # where all of it has yielded
            weights[at[terms.index("loop")] :][: len(YIELDS)] = 1.0
        spread = math.sqrt(max(float(weights @ fit.covariance @ weights), 0.0))
        out[term] = float(weights @ fit.x), spread
    return out


def regress(
    twists: Sequence[Twist], columns: Sequence[Array], off_centre: bool, known: Array | None = None
) -> Linear:
    """A least-squares fit of torsion to columns, with the sensors' own errors removed from each
    recording; ``known`` coefficients are only applied.
    """
    left, right = [], []
    for twist, matrix in zip(twists, columns, strict=True):
        q = nuisance(twist, off_centre)
        y = twist.torsion[twist.kept]
        left.append(matrix - q @ (q.T @ matrix))
        right.append(y - q @ (q.T @ y))
    a, b = np.concatenate(left), np.concatenate(right)
    norms = np.linalg.norm(a, axis=0)
    norms[norms == 0] = 1.0
    if known is None:
        x = np.linalg.lstsq(a / norms, b, rcond=1e-9)[0] / norms
    else:
        x = known
    residual = [y - m @ x for m, y in zip(left, right, strict=True)]
    r = np.concatenate(residual)
    alike = max(repeats(e, t.sample_time) for e, t in zip(residual, twists, strict=True))
    variance = float(r @ r) / max(len(r) - len(x), 1) * alike
    inverse = np.linalg.pinv((a / norms).T @ (a / norms)) if len(x) else np.zeros((0, 0))
    return Linear(x, variance * inverse / np.outer(norms, norms), residual)


def evidence(
    before: Sequence[Array], after: Sequence[Array], twists: Sequence[Twist]
) -> tuple[Evidence, float]:
    """The gain in log density of one set of residuals over another, and the logarithm of the
    e-value, by the rule of ``measure/evidence.py``.
    """
    points = []
    before, after = judged(twists, before), judged(twists, after)
    for parts in (before, after):
        r = np.concatenate(parts)
        scale = max(float(r @ r) / max(len(r), 1), 1e-300)
        points.append([e**2 / scale + np.log(scale) for e in parts])
    blocks = []
    for b, a, twist in zip(*points, twists, strict=True):
        size = max(2, round(BLOCK / twist.sample_time))
        count = len(b) // size
        if count:
            blocks.append((b - a)[: count * size].reshape(count, size).sum(axis=1))
    values = np.concatenate(blocks) if blocks else np.zeros(1)
    gain, error = float(values.sum()), deviation(values)
    z = gain / error if 0 < error < np.inf else 0.0
    alike = max(repeats(e, t.sample_time) for e, t in zip(before, twists, strict=True))
    return Evidence(gain, z, values), 0.5 * gain / alike


def rms(parts: Sequence[Array]) -> float:
    """Root mean square over recordings."""
    r = np.concatenate(parts)
    return float(np.sqrt(np.mean(r**2))) if len(r) else 0.0


# --- the transmitted torque where only the joint's whole inertia is known


@dataclass(frozen=True)
class Motor:
    """The inertia before the transmission, its standard deviation, and the relative one of the
    compliance that follows from it.
    """

    inertia: float = 0.0
    std: float = 0.0
    compliance: float = 0.0


def with_motor_torque(
    fit: Sequence[Twist],
    others: Sequence[Sequence[Twist]],
    inertia: float,
    off_centre: bool,
    late: bool = False,
) -> tuple[list[Twist], list[list[Twist]], Motor]:
    """The transmitted torque from the motor's side: the drive's minus acceleration and dry friction
    of the motor, both fitted with the spring (``late``: and with late yielding).

    Returns
    -------
    fit, others, motor
    """

    from scipy.optimize import minimize_scalar  # takes half a second

    def columns(share: float, dry: float) -> list[Array]:
        out = []
        for t in fit:
            torque = t.drive - share * inertia * t.qdd
            side = gap_shape(torque - dry * t.extra["direction"])
            parts = [torque, t.extra["direction"], t.extra["rate"], side]
            if late:
                scale = rms([torque[t.kept]])
                parts += [play(torque, part * scale) for part in YIELDS]
            out.append(np.stack(parts, axis=1)[t.kept])
        return out

    dry, best = 0.0, 0.5
    for _ in range(FRICTION_ROUNDS):

        def cost(share: float, dry: float = dry) -> float:
            return rms(regress(fit, columns(share, dry), off_centre).residual)

        first = min(SHARES, key=cost)
        bounds = (max(0.0, first - SHARE_STEP), min(1.0, first + SHARE_STEP))
        best = float(minimize_scalar(cost, bounds=bounds, method="bounded").x)
        found = regress(fit, columns(best, dry), off_centre)
        dry = max(0.0, -float(found.x[1] / found.x[0])) if found.x[0] < 0 else 0.0
    apart = []
    for t in fit:
        side = gap_shape(t.drive - best * inertia * t.qdd - dry * t.extra["direction"])
        parts = [t.drive, t.qdd, t.extra["direction"], t.extra["rate"], side]
        apart.append(np.stack(parts, axis=1)[t.kept])
    loose = regress(fit, apart, off_centre)
    compliance, spread = np.sqrt(np.diag(loose.covariance)[:2]) / max(abs(loose.x[0]), 1e-300)

    def with_torque(ts: Sequence[Twist]) -> list[Twist]:
        return [
            replace(t, torque=t.drive - best * inertia * t.qdd - dry * t.extra["direction"])
            for t in ts
        ]

    # for a pure inertia load only the ratio to the compliance is known: any share may be the load's
    guessed = _blurred(fit, apart, off_centre) / np.sqrt(12.0)
    motor = Motor(
        best * inertia,
        float(np.hypot(spread, guessed * inertia)),
        float(np.hypot(compliance, guessed / max(1.0 - best, 0.02))),
    )
    return with_torque(fit), [with_torque(ts) for ts in others], motor


def _blurred(fit: Sequence[Twist], columns: Sequence[Array], off_centre: bool) -> float:
    """The part of noise, 0 to 1, in the variance of the acceleration (column 1) that the other
    columns do not explain.
    """
    own = [replace(t, torsion=np.where(t.kept, t.qdd, 0.0)) for t in fit]
    rest = [np.delete(c, 1, axis=1) for c in columns]
    left = rms(regress(own, rest, off_centre).residual)
    return float(min(1.0, (max(t.blur for t in fit) / max(left, 1e-300)) ** 2))


def joint_inertia(data: Data, model: Model, joint: int) -> float:
    """The inertia of a joint with all that the model has on it, kg m² or kg."""
    return float(np.mean(effective_inertia(data.records[0][joint - 1], model)))


# --- an error over the angle


def strongest_order(twists: Sequence[Twist], residual: Sequence[Array]) -> float:
    """The strongest order of a residual over the angle, with at least one period within the
    recordings; 0 where there is none.

    Rows are summed into bins of the angle and transformed at once.
    """
    q = np.concatenate([t.q[t.kept] for t in twists])
    r = np.concatenate(residual)
    span = float(np.ptp(q))
    fast = max(float(np.quantile(np.abs(t.qd[t.kept]), 0.9)) for t in twists)
    lowest = 2 * np.pi / span
    highest = min(0.8 * np.pi / (max(t.sample_time for t in twists) * fast), ORDERS * lowest / 8)
    if not highest > 3 * lowest:
        return 0.0
    places = int(4 * highest * span / (2 * np.pi)) + 1
    place = np.minimum((places * (q - q.min()) / span).astype(int), places - 1)
    total = np.bincount(place, r, places)
    size = 8 * places
    power = np.abs(np.fft.rfft(total, size)) ** 2
    orders = 2 * np.pi * np.arange(len(power)) / (size * span / places)
    use = (orders >= 2 * lowest) & (orders <= highest)
    if not use.any():
        return 0.0
    return float(orders[use][np.argmax(power[use])])
