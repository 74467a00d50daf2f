"""The transmitted torque from the motor's side, where only the joint's whole inertia is known: the
drive's torque minus what accelerates the motor. The motor's inertia is fitted too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.transmission.torsion import Array, Twist
from zendsp.diagnosis.transmission.torsion_fit import YIELDS, gap_shape, play, regress, rms
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import effective_inertia
from zendsp.physics.model import Model

FRICTION_ROUNDS = 2  # alternating estimates of the motor's inertia and its dry friction
SHARE_STEP = 0.1  # of the joint's inertia: step of first tries of the motor's part
SHARES = tuple(SHARE_STEP * (i + 0.5) for i in range(10))


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
