"""The torsion of one joint in the three parts of the data, and the lag of its second sensor."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from zendsp.diagnosis.data.series import repeats
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.thresholds import SURE
from zendsp.diagnosis.transmission.torsion import Twist, joined, lowpass, twists
from zendsp.diagnosis.transmission.torsion_fit import gap_shape, rms
from zendsp.physics.model import Model

# of the RMS torque: below, a gap may be open. With the motor's torque alone, a simulated gap of 12
# mrad came out at 9.5 from rows above 0.3, and at 11.0 from those above 0.6
OPEN = 0.6
# of the RMS torque, and periods of the low-pass around a row: least torque that presses on one side
# of a gap. Nearer to a crossing a row averages both sides, and under less torque a contact bounces:
# two simulated gaps of 12 mrad came out at 11.5 and 10.8 from all rows; a contact of 10 000 N m/rad
# at 9 200 from rows above 0.6, at 9 920 from those above 1
PRESSING, PRESSED = 1.0, 1.0
# of the rows at which a gap is surely closed: fewer would be worse than all of them
ENOUGH_PRESSED = 0.2


@dataclass(frozen=True)
class Sets:
    """The three parts of the data at one joint."""

    fit: list[Twist]
    choose: list[Twist]
    test: list[Twist]

    def each(self, change: Callable[[Twist], Twist]) -> Sets:
        """The sets with every recording changed."""
        return Sets(*([change(t) for t in part] for part in (self.fit, self.choose, self.test)))


def sets_of(parts: Parts, model: Model, joint: int) -> Sets:
    """The sets of raw torsion; halves of one recording share their sensors' zeros."""
    fit = twists(parts.fit, model, joint)
    choose = twists(parts.choose, model, joint)
    if parts.choose is parts.test:
        return Sets(fit, choose, choose)
    test = twists(parts.test, model, joint)
    if len(choose) == len(test) == 1 and _follows(parts, joint):
        choose, test = [[joined(choose[0], test[0], part)] for part in (0, 1)]
    return Sets(fit, choose, test)


def _follows(parts: Parts, joint: int) -> bool:
    """Whether the recording to test on begins where the one to choose by ends."""
    first, second = parts.choose.records[0][joint - 1], parts.test.records[0][joint - 1]
    gap = second.t0 - first.t0 - first.n * first.sample_time
    return abs(gap) < 0.5 * first.sample_time


def loaded(twist: Twist) -> Twist:
    """The twist without rows at which a gap may be open: no law says on which side the load is
    then.
    """
    size = rms([twist.torque[twist.kept]])
    return replace(twist, kept=twist.kept & (np.abs(twist.torque) > OPEN * size))


def _pressed(twist: Twist) -> Twist:
    """The mask of loaded rows around which the torque presses on the same side."""
    from scipy.ndimage import maximum_filter1d, minimum_filter1d  # takes half a second

    size = rms([twist.torque[twist.kept]])
    side = np.where(np.abs(twist.torque) > PRESSING * size, np.sign(twist.torque), 0.0)
    rows = 2 * round(PRESSED / (twist.band * twist.sample_time)) + 1
    alike = maximum_filter1d(side, rows) == minimum_filter1d(side, rows)
    return replace(twist, kept=twist.kept & alike & (side != 0.0))


def clear_of_a_gap(slow: Sets) -> Sets:
    """The twist with rows that show the side of a gap in spite of the low-pass; all loaded rows of
    a side where these are few. A weight may press on one side nearly always: without the loaded
    rows of the other, a gap of 3 mrad was a spring.
    """
    under, pressed = slow.each(loaded), slow.each(_pressed)

    def rows(sets: Sets, side: float) -> list[int]:
        parts = (sets.fit, sets.choose, sets.test)
        return [sum(int((np.sign(t.torque) == side)[t.kept].sum()) for t in p) for p in parts]

    few = [
        side
        for side in (-1.0, 1.0)
        if any(
            p < ENOUGH_PRESSED * r
            for p, r in zip(rows(pressed, side), rows(under, side), strict=True)
        )
    ]

    def enough(part: Sequence[Twist], loose: Sequence[Twist]) -> list[Twist]:
        return [
            replace(p, kept=np.where(np.isin(np.sign(p.torque), few), u.kept, p.kept))
            for p, u in zip(part, loose, strict=True)
        ]

    return Sets(
        enough(pressed.fit, under.fit),
        enough(pressed.choose, under.choose),
        enough(pressed.test, under.test),
    )


def lag_of(raw: Sets, band: float) -> float:
    """The lag of the second sensor's column, s: the torsion proportional to speed, beside all that
    a transmission may do; 0 where it is not sure.

    The drive's torque is no column beside that of the bodies. What it has more is the motor's
    friction, so the two together are proportional to speed: noise of the bodies' torque made an
    early column of 1 ms out of a viscous friction of 1.8 N m s/rad before a spring of 2160 N m/rad.
    """
    slow = clear_of_a_gap(raw.each(lambda t: lowpass(t, band))).fit
    columns, y = [], []
    for t in slow:
        parts = [t.qd, t.torque, t.qdd, t.extra["direction"], gap_shape(t.torque)]
        parts += [np.ones_like(t.q), np.sin(t.q), np.cos(t.q)]
        columns.append(np.stack(parts, axis=1)[t.kept])
        y.append(t.torsion[t.kept])
    a = np.concatenate(columns)
    norms = np.linalg.norm(a, axis=0)
    a /= np.where(norms > 0, norms, 1.0)
    x = np.linalg.lstsq(a, np.concatenate(y), rcond=1e-9)[0]
    left = np.split(np.concatenate(y) - a @ x, np.cumsum([len(v) for v in y])[:-1])
    alike = max(repeats(e, t.sample_time) for e, t in zip(left, slow, strict=True))
    std = rms(left) * math.sqrt(alike * np.linalg.pinv(a.T @ a, rcond=1e-9)[0, 0])
    return -float(x[0] / norms[0]) if abs(x[0]) > SURE * std else 0.0


def torque_scale(twists: Sequence[Twist]) -> float:
    """RMS torque through the transmission, N m, as the scale of a fit that makes it independent of
    units.
    """
    return max(rms([t.torque[t.kept] for t in twists]), 1e-300)


def torque_unit(model: Model, joint: int) -> str:
    """The unit of torque: N m, or N for a linear joint."""
    return "N" if model.joint_kind(joint) == "linear" else "N m"


def compliance_unit(model: Model, joint: int) -> str:
    """The unit of compliance: rad/(N m), or m/N for a linear joint."""
    return "m/N" if model.joint_kind(joint) == "linear" else "rad/(N m)"
