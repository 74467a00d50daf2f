"""Columns that no machine could have made: a position that moves before its command and is smoother
than its sensor, and a command that acts beyond the limit of its actuator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.plausibility import command_unit
from zendsp.diagnosis.data.regression import Regression, look, regress, rigid_body
from zendsp.errors import RecordingError
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.kernel.signals import noise_beside_quantisation
from zendsp.physics.model import Model, per_joint

Array = npt.NDArray[np.float64]

# What accuses a recording: tests/diagnosis/test_causes.py has some on either side.
NOISELESS = 0.01  # of a count: rounding alone makes 0.29; EMPS, whose drive interpolates, has 0.13
COMPUTED = 1e-9  # of the span: less noise than a sensor of 26 bits, of which none is stated
LEADS_S = (0.005, 0.01, 0.02, 0.05, 0.1)  # s by which a loop may follow its set value
LEADS_ROWS = 3  # at least: a log may be late by a row or two
LEFT_HALVED = 0.5  # of what a regression leaves: the other explanation is the better one
CAUSED = 0.8  # R^2 of a regression that may accuse
LIMIT_ROUNDED = 1.05  # of the limit: more than a limit that was rounded
LIMIT_PASSES = 0.02  # of the time: least beyond the limit
SAME_UNIT = (0.8, 1.25)  # of the model's inertia: within, the command is in its unit


@dataclass(frozen=True)
class _Motion:
    """Positions and commands of all joints, (joints, n), with the noise of the positions."""

    positions: Array
    commands: Array
    noise: Array
    period: float  # s
    model: Model

    def fit(self, joint: int, commands: Array, late: int = 0) -> Regression | None:
        """The regression of a joint (from 1) with these commands, ``late`` rows of which are left
        out at the beginning, and as many of the positions at the end.
        """
        rows = self.positions.shape[1] - late
        slow = look(self.positions[:, :rows], commands[:, late:], self.period, self.noise)
        slow = replace(slow, at_edge=np.zeros_like(slow.at_edge))  # the largest ones count here
        return regress(slow, self.model, joint, rigid_body(slow, self.model))


def check_caused(where: Sequence[str], records: Sequence[JointRecord], model: Model) -> None:
    """Refuse a position that moves before its command, and a command that acts beyond the limit of
    its actuator.

    Parameters
    ----------
    where : sequence of str
        Name of each joint for messages.
    records : sequence of JointRecord
        All joints of one recording, or of a part.

    Raises
    ------
    RecordingError
        With the likely mistake.
    """
    motion = _Motion(
        np.stack([r.position for r in records]),
        np.stack([r.command for r in records]),
        np.array([r.measurement.std for r in records]),
        records[0].sample_time,
        model,
    )
    for joint, name in enumerate(where, 1):
        if np.any(motion.commands[joint - 1]):
            _lead(name, motion, joint)
            _limit(name, motion, joint)


def _lead(name: str, motion: _Motion, joint: int) -> None:
    """Refuse a set value named as the position: it has no noise of a sensor, and the machine
    follows it, so that its motion fits the command best that comes later.
    """
    y, period = motion.positions[joint - 1], motion.period
    stated = per_joint(motion.model.sensor.resolution, joint, 0.0)
    steps = np.abs(np.diff(y))
    if stated > 0 and np.all((steps == 0.0) | (steps > 0.5 * stated)):
        return  # in counts: of slow motion their rounding is no noise
    noise = noise_beside_quantisation(y, 0.0)
    if noise > (NOISELESS * stated if stated > 0 else COMPUTED * float(np.ptp(y))):
        return
    best, lead = motion.fit(joint, motion.commands), 0.0
    if best is None:
        return
    first = best.r2
    for seconds in LEADS_S:
        rows = round(seconds / period)
        if LEADS_ROWS <= rows < len(y) // 4:
            found = motion.fit(joint, motion.commands, rows)
            if found is not None and found.r2 > best.r2:
                best, lead = found, rows * period
    if best.r2 > CAUSED and 1.0 - best.r2 < LEFT_HALVED * (1.0 - first):
        than = f"a sensor of {stated:.4g} a count" if stated > 0 else "any sensor"
        raise RecordingError(
            f"{name}: the position moves {1e3 * lead:.3g} ms before the command that would have to"
            f" move it, and has less noise than {than}: [columns] names a set value as the"
            " position. Name the column of the sensor, and this one as reference. (Where it is"
            " simulated, the command column is that much late.)"
        )


def _limit(name: str, motion: _Motion, joint: int) -> None:
    """Refuse a command beyond the stated limit of its actuator that moves the joint there, as one
    in another unit does. What a drive cuts off at its limit moves nothing.
    """
    commands, model = motion.commands, motion.model
    limit = per_joint(model.actuator.limit, joint, 0.0)
    size = np.abs(commands[joint - 1])
    share = float(np.mean(size > LIMIT_ROUNDED * limit))
    if limit <= 0 or share < LIMIT_PASSES:
        return
    cut = commands.copy()
    cut[joint - 1] = np.clip(cut[joint - 1], -limit, limit)
    whole, without = motion.fit(joint, commands), motion.fit(joint, cut)
    if whole is None or without is None or whole.r2 < CAUSED:
        return
    if 1.0 - whole.r2 > LEFT_HALVED * (1.0 - without.r2):
        return
    unit = command_unit(model, joint - 1)
    said = (
        f"{name}: the command is beyond the actuator's limit of {limit:.4g} {unit} for"
        f" {100 * share:.0f} % of the time, to {float(size.max()):.4g}, and the joint follows it"
        " there: "
    )
    if SAME_UNIT[0] < whole.slope < SAME_UNIT[1]:
        raise RecordingError(f"{said}give [actuator] the limit that it has, or none")
    gain = per_joint(model.actuator.gain, joint, 1.0) / whole.slope
    other = "a torque in N m" if unit == "A" else f"a current in A in place of {unit}"
    raise RecordingError(
        f"{said}is it in another unit ({other})? By the model's inertia its unit is"
        f" {gain:.2g} times that of the joint's torque. Write the unit that its numbers have into"
        f" the column's head, and into [actuator]: unit, gain ({gain:.2g}) and limit in that unit"
    )
