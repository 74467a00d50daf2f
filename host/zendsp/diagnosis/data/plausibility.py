"""Recordings that contradict mechanics: wrong units, flipped signs, swapped columns, commands that
do not belong to the motion.

Where the coefficient of the rigid body (``regression``) is far from 1, and no missing body explains
it (``carried``), the likely mistakes are undone one by one. The one that brings it back to 1 is
named.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.carried import is_carried, is_tool
from zendsp.diagnosis.data.order import check_order
from zendsp.diagnosis.data.regression import (
    CUTOFFS_HZ,
    TURNS,
    Regression,
    Slow,
    look,
    regress,
    rigid_body,
)
from zendsp.errors import RecordingError
from zendsp.physics.calibration.joint import (
    JointRecord,
    along,
    effective_inertia,
    mechanism_value,
)
from zendsp.physics.calibration.observed import trace
from zendsp.physics.kernel.signals import is_set_value
from zendsp.physics.model import TREES, Model, per_joint

Array = npt.NDArray[np.float64]

DEGREE = 180.0 / np.pi

# What accuses a recording: tests/diagnosis/test_bad_input.py has recordings on either side.
SHOWS = 0.25  # of the command: a smaller rigid-body torque is no ground to accuse a column
# of the torque: a larger negative friction means that two columns of the regression cancel
FULL = 1.5
ERRORS = 4  # standard errors: least distance of a factor beyond a limit
MANY_ERRORS = 10  # the same for a sign, with correlated samples counted once
SURE_ERRORS = 8  # the same for the factor once a mistake is undone
LITTLE, MUCH = 0.3, 5.0  # of the model's inertia: outside, units of columns may be wrong
GEARED = 7.0  # of all joints' inertias: a model of a real KR 300 is off by 4, a gear by 10 and more
BY_GUESS = 100.0  # of a joint's inertia: farther off is no guess of it, but a unit or a gear
NONE = 0.2  # of the model's inertia: less counts as not seen
# of the command: a rigid body that should need this much must be seen
INERTIAL_SHARE = 0.3
# of the command: beside joints that agree with the model, a joint whose body needs this much is
# moved by them, not by its own torque. The first joint of a real acrobot has 3 to 10
PASSIVE = 3.0
VISIBLE = 0.05  # of the command: a smaller rigid-body torque cannot show its sign
SOUND = 0.6  # R^2 of a regression that may accuse a column
HALF = 0.5  # R^2 of one that explains the motion by half
GOOD = 0.8  # R^2 of one that may call a column clipped
R2_NO_WORSE = 0.05  # most loss of R^2 when a mistake is undone
BEYOND, BEYOND_ERRORS = 0.15, 4.5  # of the command at its edge, and in standard errors: clipped
SATURATED = 0.98  # of the stated limit: from there on the actuator clips as well
CLIPPED_INERTIA = (0.4, 2.5)  # of the model's inertia: within, a column may be called clipped
RIGHT = (0.5, 2.0)  # of the model's inertia: within, a mistake counts as undone
UNIT_TOLERANCE = 0.8  # of a factor between units
DRIVES = 0.3  # of the torque: friction that adds this much is negative


@dataclass(frozen=True)
class _Looked:
    """A recording or a part of one: motion, commands and noise of all joints, (joints, n) and
    (joints,); the rigid body's torques; and each joint's regression, None where it shows nothing.
    """

    y: Array
    u: Array
    noise: Array
    slow: Slow
    body: tuple[Array, Array]
    found: tuple[Regression | None, ...]


def _looked(records: Sequence[JointRecord], model: Model) -> _Looked:
    y = np.stack([r.position for r in records])
    u = np.stack([r.command for r in records])
    noise = np.array([r.measurement.std for r in records])
    slow = look(y, u, records[0].sample_time, noise)
    body = rigid_body(slow, model)
    found = [
        regress(slow, model, i + 1, body) if np.any(u[i]) else None for i in range(len(records))
    ]
    return _Looked(y, u, noise, slow, body, tuple(found))


def _agreeing(found: Sequence[Regression | None]) -> set[int]:
    """The joints (from 0) whose columns are in the units of the model."""
    return {
        i
        for i, x in enumerate(found)
        if x is not None
        and x.r2 > SOUND
        and LITTLE < x.slope < MUCH
        and x.slope > SURE_ERRORS * x.error
    }


def check_driven(
    where: Sequence[str],
    records: Sequence[JointRecord],
    model: Model,
    beside: Sequence[Sequence[JointRecord]] = (),
    stated: bool = False,
    *,
    signs: bool = True,
) -> None:
    """Refuse commands that contradict the motion, joint by joint.

    Parameters
    ----------
    where : sequence of str
        Name of each joint for messages.
    records : sequence of JointRecord
        All joints of one recording, or of a part.
    beside : sequence of sequence of JointRecord
        Its other parts.
    stated : bool
        Whether the heads of the positions state their unit.
    signs : bool
        Whether a sign may be accused.

    Raises
    ------
    RecordingError
        With the likeliest mistake.
    """
    whole = where[0].removesuffix(": joint 1")
    check_order(whole, records, model, beside)
    here = _looked(records, model)
    agreeing = _agreeing(here.found)
    slopes = [
        found.slope
        for found in here.found
        if found is not None and found.r2 > GOOD and abs(found.slope) > SURE_ERRORS * found.error
    ]
    # a part in which joints hardly move says nothing about a gain that another part confirms
    others = [_agreeing(_looked(part, model).found) for part in beside]
    shown = any(others)
    # without gravity, degrees too are one common factor of all joints
    degrees = all(UNIT_TOLERANCE < abs(x) * DEGREE < 1.0 / UNIT_TOLERANCE for x in slopes)
    if not shown and not degrees and not is_tool(here.slow, model, here.body):
        scaled(whole, slopes, command_unit(model, 0))
    for i, (name, found) in enumerate(zip(where, here.found, strict=True)):
        if found is None:
            continue
        if found.share > PASSIVE and agreeing - {i}:
            continue
        # where another part shows that its columns are right, something else acts in this one
        right = any(i in each for each in others)
        little = found.slope + ERRORS * found.error < LITTLE
        if little and is_carried(here.slow, model, i + 1, here.body):
            continue
        if signs and not right:
            _sign(name, found)
        if is_set_value(here.u[i], here.y[i]):
            _set_value(name, found, [part[i] for part in (records, *beside)], model)
        much = found.slope - ERRORS * found.error > MUCH and found.r2 > HALF
        if (little or much) and not right:
            kind = model.joint_kind(i + 1)
            every = agreeing.union(*others)
            units = not any(model.joint_kind(k + 1) == kind for k in every)
            period = records[0].sample_time
            own = _own_number(model, i + 1, found.slope) if stated else ""
            likely = _mistakes(here, kind == "rotary", command_unit(model, i) if units else "", own)
            _undo(name, found, likely, period, model, i)
            _belong(name, found, here, period, model, i)
            _geared(name, found, model.kind in TREES, command_unit(model, i))
        _clipped(name, found, float(np.max(np.abs(here.u[i]))), model, i + 1)


def _clipped(name: str, found: Regression, top: float, model: Model, joint: int) -> None:
    """Refuse a command that is clipped at its largest value ``top``."""
    stated = per_joint(model.actuator.limit, joint, 0.0)
    allowed = stated > 0 and top > SATURATED * stated
    if (
        not allowed
        and found.excess > BEYOND
        and found.excess_t > BEYOND_ERRORS
        and found.r2 > GOOD
        and CLIPPED_INERTIA[0] < found.slope < CLIPPED_INERTIA[1]
    ):
        raise RecordingError(
            f"{name}: while the command column stands at its largest value {top:.4g} the joint"
            f" moves as if by {100 * found.excess:.0f} % more: the column is clipped; record it"
            " with a wider range"
        )


def command_unit(model: Model, i: int) -> str:
    """The unit in which the model expects the command of a joint (from 0)."""
    return model.actuator.unit or ("N" if model.joint_kind(i + 1) == "linear" else "N m")


def thousandfold(factor: float, unit: str) -> str:
    """The likely reason for a command 1000 times too large or too small; empty for another factor.

    Examples
    --------
    >>> thousandfold(1100.0, "A").partition("?")[0], thousandfold(10.0, "A")
    ('the command is 1000 times what the model expects: mA in place of A', '')
    """
    if RIGHT[0] < factor / 1e3 < RIGHT[1]:
        times, other = "1000 times", f"m{unit} in place of {unit}"
    elif RIGHT[0] < factor * 1e3 < RIGHT[1]:
        times, other = "a thousandth of", f"{unit} under a head that says m{unit}"
    else:
        return ""
    return (
        f"the command is {times} what the model expects: {other}? Write the unit that its numbers"
        " have into the column's head, or give [actuator] gain for it. (The model's inertia in"
        " another unit looks the same.)"
    )


def scaled(name: str, slopes: Sequence[float], unit: str) -> None:
    """Refuse recordings in which the inertias of all joints that show them are off by one factor.
    ``slopes``: inertias over the model's. ``unit``: of the command, as the model expects it.
    """
    low, high = min(slopes, default=1.0), max(slopes, default=1.0)
    # without the factor, each is within RIGHT of the model's
    alike = len(slopes) > 1 and 0.0 < high < RIGHT[1] / RIGHT[0] * low
    if alike and (low > GEARED or high < 1.0 / GEARED):
        factor = math.exp(math.fsum(map(math.log, slopes)) / len(slopes))
        why = thousandfold(factor, unit) or (
            f"divide the actuator's gain by about {factor:.2g} (a gear ratio, a torque constant, a"
            " unit of the command), or correct the model's masses"
        )
        raise RecordingError(
            f"{name}: the inertias of all joints that show theirs come out as {low:.2g} to"
            f" {high:.2g} times the model's: {why}"
        )


def _geared(name: str, found: Regression, carries: bool, unit: str) -> None:
    """Refuse a joint whose inertia no model has. ``carries``: the model has bodies, of which the
    last may be so light that what it carries has a hundred times its inertia. ``unit``: of the
    command, as the model expects it.
    """
    small = 0.0 < found.slope + ERRORS * found.error < 1.0 / BY_GUESS
    large = not carries and found.slope - ERRORS * found.error > BY_GUESS
    if found.r2 > GOOD and (small or large):
        gear = f" of about {found.slope**-0.5:.2g}" if small and found.slope > 0 else ""
        why = thousandfold(found.slope, unit) or (
            "position, command and model are of different sides of a gear, or in other units."
            f" Position and torque of a motor before a gear{gear} show such an inertia: give the"
            " model the motor's numbers, or [sensor] and [actuator] gain the gear"
        )
        raise RecordingError(
            f"{name}: the inertia comes out as {found.slope:.2g} times the model's: {why}"
        )


def _sign(name: str, found: Regression) -> None:
    sure = found.r2 > SOUND
    error = found.error * math.sqrt(found.alike)
    against = found.slope < -NONE and found.slope < -MANY_ERRORS * error
    if sure and found.share > VISIBLE and against:
        raise RecordingError(
            f"{name}: the joint accelerates against its command (its inertia comes out as"
            f" {found.slope:.2g} of the model's): the sign of the command or of the position is"
            " flipped"
        )
    # with the sign flipped its inertia would be negative, if it shows at all
    drives = -FULL < found.friction < -DRIVES and found.slope < ERRORS * error
    if sure and drives and not found.held and found.slope + ERRORS * error < LITTLE:
        raise RecordingError(
            f"{name}: friction would have to drive the joint ({100 * found.friction:.0f} % of the"
            " torque along the motion): the sign of the command or of the position is flipped"
        )


def _set_value(
    name: str, found: Regression, parts: Sequence[JointRecord], model: Model
) -> None:
    """Refuse a command that is the position in its numbers and does not move the model. ``parts``:
    all of the recording, since a set value is one throughout.
    """
    spread = ERRORS * found.error
    far = found.slope + spread < RIGHT[0] or found.slope - spread > RIGHT[1]
    if far and not _is_borne(parts, model):
        raise RecordingError(
            f"{name}: the command is all but equal to the position, and the model's inertia comes"
            f" out as {found.slope:.2g} of what it should be: [columns] names a set value of the"
            " position as the command; name the torque or the current, and this one as reference"
        )


def _is_borne(parts: Sequence[JointRecord], model: Model) -> bool:
    """Whether the model explains a joint's command at least as well as a set value would that the
    position follows late: a light pendulum that moves slowly weighs its position in numbers.
    """
    by_model = by_position = 0.0
    for record in parts:
        torque = per_joint(model.actuator.gain, record.joint, 1.0) * record.command
        q, qd, _ = record.motion.states
        followed = np.stack([q, qd, np.ones_like(q)], axis=1)
        theta, *_ = np.linalg.lstsq(followed, torque)
        by_position += float(np.sum((torque - followed @ theta) ** 2))
        by_model += _unborne(record, torque, model)
    return by_model <= by_position


def _unborne(record: JointRecord, torque: Array, model: Model) -> float:
    """The squares that are left of a torque by the model's body, weight and terms, each right
    within ``RIGHT``, and by friction and a constant.
    """
    from scipy.optimize import lsq_linear

    q, qd, qdd = record.motion.states
    turns = TURNS * float(np.sqrt(np.mean(qd**2))) + 1e-300
    _, bias = record.inertia_and_bias(model)
    body = effective_inertia(record, model) * qdd + bias
    own = [body, trace(record, model, model.at(record.joint), turns)]
    if weight := along(record, model).gravity:
        own.append(weight * np.sin(q))
    columns = [*own, qd, np.tanh(qd / turns), np.ones_like(q)]
    low = [RIGHT[0]] * len(own) + [0.0, 0.0, -np.inf]
    high = [RIGHT[1]] * len(own) + [np.inf] * 3
    return 2.0 * float(lsq_linear(np.stack(columns, axis=1), torque, (low, high)).cost)


def _own_number(model: Model, joint: int, slope: float) -> str:
    """What to do about the model where its inertia should be ``slope`` times as large."""
    key = "mass" if model.joint_kind(joint) == "linear" else "inertia"
    value = mechanism_value(model, key, joint)
    number = f" ({value:.4g}; {slope * value:.2g} would)" if value else ""
    return thousandfold(slope, command_unit(model, joint - 1)) or (
        f"the model's {key}{number} does not go with the recording; or the position is on the other"
        " side of a gear than the command, or the command in another unit ([actuator] gain)"
    )


def _mistakes(
    here: _Looked, rotary: bool, of: str, own: str = ""
) -> list[tuple[str, tuple[Array, Array, Array]]]:
    """The likely mistakes, with position, command and noise after undoing each. ``of``: the unit of
    the command; empty where a wrong unit is excluded, since all joints of a kind share it. ``own``:
    what is wrong of the model where the position's head states its unit; else empty.
    """
    y, u, noise = here.y, here.u, here.noise
    small = DEGREE if rotary else 1e3
    words = "degrees, not radians" if rotary else "millimetres, not metres"
    unit = "deg" if rotary else "mm"
    head = "write the unit in the column's head, as 'q"
    # no inertia tells degrees from a gear: it is right to a factor of two at best
    geared = "; or it is on the other side of a gear than the command ([actuator] gain)"
    # no inertia of a joint that slides tells millimetres from a command 1000 times too small
    milli = "" if rotary or not of else f"; or, if it stands there, {thousandfold(1e-3, of)}"
    other = geared if rotary else milli
    why = f"the position is in {words}: {head} [{unit}]' or q_{unit}{other}"
    if own:
        why = f"the position's head states its unit, so {own}"
    of_units = [
        (why, (y / small, u, noise / small)),
        (thousandfold(1e3, of), (y, u / 1e3, noise)),
        (thousandfold(1e-3, of), (y, u * 1e3, noise)),
    ]
    return [
        *(of_units if of else []), ("position and command are swapped", (u, y, 0 * noise))
    ]


def _undo(
    name: str,
    found: Regression,
    mistakes: Sequence[tuple[str, tuple[Array, Array, Array]]],
    period: float,
    model: Model,
    i: int,
) -> None:
    """Refuse a recording with the name of the mistake that, undone, makes it agree with the model.
    """
    for words, (q, command, spread) in mistakes:
        slow = look(q, command, period, spread)
        again = regress(slow, model, i + 1, rigid_body(slow, model))
        if again is None or again.share < SHOWS:
            # with this mistake undone the inertia would hardly show, as at a hardly driven joint:
            # no explanation
            continue
        if (
            again.r2 > max(SOUND, found.r2 - R2_NO_WORSE)
            and RIGHT[0] < again.slope < RIGHT[1]
            and again.slope > SURE_ERRORS * again.error
        ):
            raise RecordingError(
                f"{name}: the model's inertia comes out as {found.slope:.2g} of what it should be:"
                f" {words}"
            )


def _belong(
    name: str, found: Regression, here: _Looked, period: float, model: Model, i: int
) -> None:
    """Refuse a command that does not produce the motion. Where it does so at low frequencies, the
    columns belong together, and something flexible moves at higher ones.
    """
    # an inertia far from the model's dominates the motion: no added physics could explain it
    hidden = found.slope + ERRORS * found.error < NONE
    if not hidden or found.share <= INERTIAL_SHARE or found.r2 >= HALF:
        return
    for cutoff in CUTOFFS_HZ[1:]:
        slow = look(here.y, here.u, period, here.noise, (cutoff,))
        low = regress(slow, model, i + 1, rigid_body(slow, model))
        if low is not None and low.r2 > SOUND and RIGHT[0] < low.slope < RIGHT[1]:
            return
    raise RecordingError(
        f"{name}: the command does not produce this motion (it explains"
        f" {100 * max(found.r2, 0.0):.0f} % of it, and the model's inertia does not show): are the"
        " columns of different runs, joints or units?"
    )


def check_free(
    where: Sequence[str], records: Sequence[JointRecord], model: Model, stated: bool = False
) -> None:
    """Refuse a free swing that contradicts gravity. ``stated``: the heads of the positions state
    their unit.

    Raises
    ------
    RecordingError
        The angle looks like degrees, or 0 like the upright position.
    """
    for name, record in zip(where, records, strict=True):
        weight = mechanism_value(model, "gravity", record.joint)
        inertia = mechanism_value(model, "inertia", record.joint)
        if model.kind != "rotary" or weight == 0 or inertia == 0:
            continue
        noise = np.array([record.measurement.std])
        ratio, r2 = _swing(record.position[None], record.sample_time, noise, inertia, weight)
        if r2 > SOUND and ratio < -LITTLE:
            raise RecordingError(
                f"{name}: the joint swings about the position pi; the model takes 0 as hanging"
                " down: add pi by [sensor] offset"
            )
        other, better = _swing(
            record.position[None] / DEGREE, record.sample_time, noise / DEGREE, inertia, weight
        )
        if r2 < SOUND < better and other > LITTLE and not stated:
            raise RecordingError(
                f"{name}: the joint swings as gravity says only if the position is in degrees;"
                " expected radians: write the unit in the column's head, as 'q [deg]'"
            )


def _swing(
    q: Array, period: float, noise: Array, inertia: float, weight: float
) -> tuple[float, float]:
    slow = look(q, np.zeros_like(q), period, noise)
    need = inertia * slow.qdd[0]
    a = np.stack([-weight * np.sin(slow.q[0]), slow.qd[0], np.ones_like(slow.q[0])], axis=1)
    theta, *_ = np.linalg.lstsq(a, need, rcond=1e-10)
    left = need - a @ theta
    return float(theta[0]), 1.0 - float(left @ left) / max(
        float(np.sum((need - need.mean()) ** 2)), 1e-300
    )
