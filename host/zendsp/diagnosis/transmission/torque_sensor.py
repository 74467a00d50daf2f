"""Separates, by a joint torque sensor, friction before and after it, and an actuator's gain from a
load.

Before the sensor the drive's torque accelerates the motor and overcomes its friction; after it the
sensed torque moves the load and overcomes the load's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.data.series import repeats
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.contract import DetailsReport
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.thresholds import PLAIN, SURE
from zendsp.diagnosis.measure.curve import FLUID, FRICTION
from zendsp.diagnosis.transmission.findings import measured
from zendsp.diagnosis.transmission.torsion import OF_MOTOR, Array, has_bodies, held_drive
from zendsp.diagnosis.transmission.torsion import STILL as STANDING
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.model import Model

ONE_SIDE = 0.2  # of the other side's friction: less is not reported
GAIN = 0.05  # largest standard deviation of a gain that is used

Number = tuple[float, float]


@dataclass(frozen=True)
class Sides:
    """Dry and viscous friction before and after a torque sensor, the actuator's gain, and the
    inertia before the sensor; each with its standard deviation.
    """

    dry: tuple[Number, Number]
    viscous: tuple[Number, Number]
    gain: Number
    motor: Number

    @property
    def side(self) -> str:
        """The side of the dry friction; of the viscous one where there is no dry."""
        return side_of(self.dry) or side_of(self.viscous)


def side_of(friction: tuple[Number, Number]) -> str:
    """``"before"``, ``"after"`` or ``"both"``; empty where no friction is sure."""
    (before, b), (after, a) = friction
    sure = before > SURE * b, after > SURE * a
    if not any(sure):
        return ""
    if not sure[1] or after < ONE_SIDE * before:
        return "before"
    return "after" if not sure[0] or before < ONE_SIDE * after else "both"


@dataclass(frozen=True)
class Rows:
    """Low-passed signals of one recording where the joint moves, (rows,) each."""

    sample_time: float
    drive: Array  # torque of the actuator
    sensed: Array
    bodies: Array  # torque of the model's bodies; 0 where it has none
    qd: Array
    qdd: Array
    s: Array  # direction
    sin: Array  # of the angle
    cos: Array

    @property
    def free(self) -> list[Array]:
        """Columns of an unknown load: inertia and gravity."""
        return [self.qdd, self.sin, self.cos]


def sides_of(parts: Parts, model: Model, joint: int) -> Sides | None:
    """The friction on both sides of a joint's torque sensor; None where it has no such sensor."""
    records = [rec[joint - 1] for rec in parts.fit.records]
    if any("torque_measured" not in r.columns for r in records):
        return None
    rows = [_rows(r, model, joint) for r in records]
    whole = has_bodies(model)
    before = _fit([(r.drive - r.sensed, [r.qdd, r.qd, r.s], r) for r in rows])
    after = _fit([(r.sensed - r.bodies, [r.qd, r.s, *([] if whole else r.free)], r) for r in rows])
    gain = _fit([(r.sensed, [r.drive, r.qdd, r.qd, r.s], r) for r in rows])
    return Sides((before[2], after[1]), (before[1], after[0]), gain[0], before[0])


def _rows(record: JointRecord, model: Model, joint: int) -> Rows:
    from scipy.signal import butter, sosfiltfilt  # takes half a second

    fs = 1.0 / record.sample_time
    sos = butter(4, min(OF_MOTOR, 0.2 * fs), fs=fs, output="sos")
    q, qd, qdd = record.motion.states
    inertia, bias = record.inertia_and_bias(model)
    fast = STANDING * max(float(np.quantile(np.abs(qd), 0.98)), 1e-12)
    use = np.abs(qd) > fast
    edge = max(2, round(0.05 * fs))
    use[:edge] = use[-edge:] = False
    signals = (
        held_drive(record, model, joint),
        record.columns["torque_measured"],
        inertia * qdd + bias if has_bodies(model) else np.zeros(record.n),
        qd,
        qdd,
        np.tanh(qd / fast),
        np.sin(q),
        np.cos(q),
    )
    return Rows(record.sample_time, *(sosfiltfilt(sos, x)[use] for x in signals))


def _fit(parts: Sequence[tuple[Array, list[Array], Rows]]) -> list[Number]:
    """Least squares with a zero for each recording: coefficients with standard deviations."""
    left, right = [], []
    for y, columns, _ in parts:
        a = np.stack(columns, axis=1)
        left.append(a - a.mean(axis=0))
        right.append(y - y.mean())
    a, b = np.concatenate(left), np.concatenate(right)
    norms = np.linalg.norm(a, axis=0)
    norms[norms == 0] = 1.0
    x = np.linalg.lstsq(a / norms, b, rcond=1e-9)[0] / norms
    residual = [r - m @ x for m, r in zip(left, right, strict=True)]
    alike = max(repeats(e, p[2].sample_time) for e, p in zip(residual, parts, strict=True))
    total = sum(float(e @ e) for e in residual)
    variance = total / max(len(b) - len(x), 1) * alike
    spread = np.sqrt(variance * np.diag(np.linalg.pinv((a / norms).T @ (a / norms)))) / norms
    return [(float(v), float(s)) for v, s in zip(x, spread, strict=True)]


def sided(findings: Sequence[Finding], parts: Parts, model: Model) -> tuple[Finding, ...]:
    """The findings, with the side of the torque sensor on which a friction acts, and without rivals
    that the sensor excludes.
    """
    known: dict[int, Sides | None] = {}
    out = []
    for f in findings:
        if f.joint not in known:
            known[f.joint] = sides_of(parts, model, f.joint)
        sides = known[f.joint]
        unit = model.torque_unit(f.joint)
        if f.mechanism == FLUID:
            unit += " s/m" if model.joint_kind(f.joint) == "linear" else " s/rad"
        out.append(f if sides is None else _with_sides(f, sides, unit))
    return tuple(out)


def on_both_sides(findings: Sequence[Finding], parts: Parts, model: Model) -> list[str]:
    """Notes on the friction before and after each torque sensor, of joints where nothing found says
    it: the model may have all of it, and only one place for it.
    """
    out = []
    told = {f.joint for f in findings if "side" in f.numbers.get("details", {})}
    for joint in sorted({*range(1, model.joints + 1)} - told):
        sides = sides_of(parts, model, joint)
        if sides is None or not sides.side:
            continue
        if any(value < -SURE * std for value, std in (*sides.dry, *sides.viscous)):
            out.append(
                f"joint {joint}: torque_measured does not fit the command: friction on one side of"
                " it would drive the joint. Is its unit or sign another, or is a gear between?"
            )
            continue
        unit = model.torque_unit(joint)
        speed = "m" if model.joint_kind(joint) == "linear" else "rad"
        each = [
            f"{name} friction of {before:.2g} ± {b:.1g} {u} before it and of {after:.2g} ± {a:.1g}"
            f" {u} after it"
            for name, ((before, b), (after, a)), u in (
                ("dry", sides.dry, unit), ("viscous", sides.viscous, f"{unit} s/{speed}"),
            )
            if side_of(((before, b), (after, a)))
        ]  # fmt: skip
        out.append(f"joint {joint}: by the torque sensor, {' and '.join(each)}")
    return out


def _with_sides(f: Finding, sides: Sides, unit: str) -> Finding:
    own, name = (sides.viscous, "viscous") if f.mechanism == FLUID else (sides.dry, "dry")
    rubs = f.mechanism in FRICTION and not measured(f)  # that friction is between the sides
    side = (side_of(own) or sides.side) if rubs else ""
    if side:
        words = {
            "before": "before the torque sensor, on the motor's side",
            "after": "after the torque sensor, on the load's side",
            "both": "on both sides of the torque sensor",
        }[side]
        (before, _), (after, _) = own
        details: DetailsReport = {
            **f.numbers.get("details", {}),
            "side": side,
            "dry_before": sides.dry[0][0],
            "dry_after": sides.dry[1][0],
            "viscous_before": sides.viscous[0][0],
            "viscous_after": sides.viscous[1][0],
        }
        text = (
            f"{f.sentence} It acts {words}: {name} friction of {before:.2g} {unit} before it and of"
            f" {after:.2g} {unit} after it."
        )
        return replace(f, sentence=text, numbers={**f.numbers, "details": details})
    gain, std = sides.gain
    if std < GAIN and "torque_gain" in f.indistinguishable and abs(gain - 1.0) < PLAIN * std:
        left = tuple(name for name in f.indistinguishable if name != "torque_gain")
        text = (
            f"{f.sentence} By the torque sensor the actuator gives {gain:.3g} of what it is told:"
            " it is no torque gain."
        )
        return replace(f, indistinguishable=left, sentence=text)
    return f
