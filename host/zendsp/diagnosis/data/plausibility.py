"""Recordings that contradict mechanics: wrong units, flipped signs, swapped columns, commands that
do not belong to the motion.

Each joint's command is regressed on what the model's rigid body needs along the measured motion,
below about 20 Hz (inverse dynamics with the same filter on both sides; Gautier and Khalil 1990).
The coefficient of the rigid body is 1 where recording and model agree, whatever friction, spring or
offset is missing, for those have columns of their own. Where it is far from 1 the likely mistakes
are undone one by one; the one that brings it back is named.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.series import repeats
from zendsp.errors import RecordingError
from zendsp.physics.calibration.joint import JointRecord, mechanism_value
from zendsp.physics.kernel.smooth import gaussian
from zendsp.physics.model import TREES, Model, per_joint
from zendsp.physics.robots.bodies import NUMBERS, Links, machine_tree
from zendsp.physics.robots.rigid import bases
from zendsp.physics.term_numbers import added_inertia

Array = npt.NDArray[np.float64]

DEGREE = 180.0 / np.pi
CUTOFFS_HZ = (20.0, 10.0, 5.0, 2.5)  # Hz
EDGE = 0.999  # of the largest command: at it
SHOWS = 0.25  # of the command: a rigid body's torque below is no ground to accuse a column
# of the torque: friction that drives by more is two columns of the regression against each other
FULL = 1.5

# What accuses a recording: tests/diagnosis/test_bad_input.py has recordings on either side.
QUIET = 0.1  # of the acceleration: so much noise does not matter
ANGLE_SPAN = 0.2  # rad: over less, sine and cosine of the angle are lines
PER_COLUMN = 4  # samples at least for each column of a regression
AT_EDGE = 12  # samples at the largest command: fewer tell nothing
ERRORS = 4  # standard errors by which a factor has to lie beyond a limit
MANY_ERRORS = 10  # the same, for a sign: with the samples that are one fact counted once
SURE_ERRORS = 8  # the same, for the factor once a mistake is undone
LITTLE, MUCH = 0.3, 5.0  # of the model's inertia: outside, columns may have wrong units
GEARED = 7.0  # of all joints' inertias: a model of a real KR 300 is off by 4, a gear by 10 and more
NONE = 0.2  # of the model's inertia: below, it does not show
# of the command: a rigid body that should take so much of it, and does not show
INERTIAL_SHARE = 0.3
VISIBLE = 0.05  # of the command: a rigid body below cannot show its sign
SOUND = 0.6  # R^2 of a regression that may accuse a column
HALF = 0.5  # R^2 of one that explains the motion by half
PULLS_BACK = 0.95  # R^2 of a command by position and speed alone: it holds the joint where it is
GOOD = 0.8  # R^2 of one that may call a column clipped
R2_NO_WORSE = 0.05  # R^2 by which it may fall when a mistake is undone
BEYOND, BEYOND_ERRORS = 0.15, 4.5  # of the command at its edge, and in standard errors: clipped
SATURATED = 0.98  # of the stated limit: from there on the actuator clips as well
CLIPPED_INERTIA = (0.4, 2.5)  # of the model's inertia: so near it a column may be called clipped
RIGHT = (0.5, 2.0)  # of the model's inertia: so near it a mistake is undone
DRIVES = 0.3  # of the torque: friction that gives so much drives
TURNS = 0.1  # of the RMS speed: below, a joint turns round
BOTH_WAYS = 0.1  # of the time that a joint must move either way for its friction to show


@dataclass(frozen=True)
class Slow:
    """All joints of one recording below the cutoff, thinned: arrays (joints, n); ``at_edge`` marks
    commands at their largest value.
    """

    q: Array
    qd: Array
    qdd: Array
    command: Array
    at_edge: npt.NDArray[np.bool_]
    sample_time: float  # s, between the thinned samples


@dataclass(frozen=True)
class Regression:
    """Torque = slope · rigid body + friction + spring + offset: slope with its standard error, R²,
    torque of the friction columns over the RMS torque.

    ``share``: RMS of the model's rigid-body torque over that of the command; ``excess``: torque
    missing at the largest commands over that command. ``alike``: so many samples of what is left
    over are one fact. ``held``: the command is that of a controller which holds the joint where it
    is while others move it, and friction's columns show that controller.
    """

    slope: float
    error: float
    r2: float
    share: float
    friction: float
    excess: float
    excess_t: float
    alike: float
    held: bool


def look(positions: Array, commands: Array, sample_time: float, noise: Array) -> Slow:
    """Filter both sides alike and thin them.

    Parameters
    ----------
    positions, commands : ndarray, shape (joints, n)
        rad or m; command units.
    sample_time : float
        s.
    noise : ndarray, shape (joints,)
        Standard deviation of the position's noise, rad or m: the cutoff falls until its share of
        the acceleration does not matter.
    """
    nyquist = 0.5 / sample_time
    for cutoff in CUTOFFS_HZ:
        cutoff = min(cutoff, 0.4 * nyquist)
        # samples: half the amplitude is left at the cutoff
        width = math.sqrt(2 * math.log(2)) / (2 * np.pi * cutoff * sample_time)
        q = gaussian(positions, width)
        qd = np.gradient(q, sample_time, axis=1)
        qdd = np.gradient(qd, sample_time, axis=1)
        white = noise * (2 * np.pi * cutoff) ** 2 * np.sqrt(0.6 * cutoff * sample_time)
        if np.all(white < QUIET * np.std(qdd, axis=1) + 1e-300):
            break
    step = max(1, round(0.2 / (cutoff * sample_time)))
    ends = min(positions.shape[1] // 8, round(0.5 / (cutoff * sample_time)))
    use = slice(ends, positions.shape[1] - ends, step)
    top = np.max(np.abs(commands), axis=1, keepdims=True)
    reach = max(1, round(0.5 / (cutoff * sample_time)))
    edge = np.abs(commands) >= EDGE * np.maximum(top, 1e-300)
    solid = np.stack(
        [
            np.convolve(row, np.ones(2 * reach + 1), mode="same") >= 2 * reach
            for row in edge.astype(float)
        ]
    )
    u = gaussian(commands, width)
    return Slow(q[:, use], qd[:, use], qdd[:, use], u[:, use], solid[:, use], step * sample_time)


def _torques(model: Model, states: Sequence[Array]) -> Array:
    out = np.zeros((len(states), states[0].shape[1]))
    for i, basis in enumerate(bases(model, list(states))):
        for key, part in basis.items():
            value = 1.0 if key == "fixed" else mechanism_value(model, key, i + 1)
            out[i] += value * (part.inertia * states[i][2] + part.bias)
    return out


def rigid_body(slow: Slow, model: Model) -> tuple[Array, Array]:
    """Torques of the model's rigid body along a motion: of the motion, and of the weight where the
    mechanism knows it, (joints, n) each.
    """
    rest = np.zeros_like(slow.q)
    states = list(np.stack([slow.q, slow.qd, slow.qdd], axis=1))
    weight = (
        _torques(model, list(np.stack([slow.q, rest, rest], axis=1)))
        if model.kind in TREES
        else rest
    )
    rigid = _torques(model, states) - weight
    for j in range(len(rigid)):
        rigid[j] += added_inertia(model, j + 1) * slow.qdd[j]
    return rigid, weight


def regress(slow: Slow, model: Model, joint: int, body: tuple[Array, Array]) -> Regression | None:
    """Regress one joint's torque (1-based) on its rigid ``body``; None where there are too few
    samples or nothing varies.
    """
    i = joint - 1
    rigid, weight = body[0][i], body[1][i]
    torque = per_joint(model.actuator.gain, joint, 1.0) * slow.command[i]
    q, qd = slow.q[i], slow.qd[i]
    speed = float(np.sqrt(np.mean(qd**2)))
    columns = [rigid, qd, np.tanh(qd / (TURNS * speed + 1e-300)), np.ones_like(q), q - np.mean(q)]
    if model.joint_kind(joint) == "rotary" and np.ptp(q) > ANGLE_SPAN:
        columns += [np.sin(q), np.cos(q)]
    if np.any(weight):
        columns.append(weight)
    use = ~slow.at_edge[i]
    a = np.stack(columns, axis=1)
    if use.sum() < PER_COLUMN * a.shape[1]:
        return None
    if not (np.std(torque[use]) > 0 and np.std(rigid[use]) > 0):
        return None
    scale = np.linalg.norm(a[use], axis=0)
    scale[scale == 0] = 1.0
    theta, *_ = np.linalg.lstsq(a[use] / scale, torque[use], rcond=1e-9)
    left = torque[use] - a[use] / scale @ theta
    spread = float(np.sum((torque[use] - torque[use].mean()) ** 2))
    variance = float(left @ left) / max(1, int(use.sum()) - a.shape[1])
    covariance = np.linalg.pinv((a[use] / scale).T @ (a[use] / scale), rcond=1e-12) * variance
    theta = theta / scale
    rub = a[:, 1] * theta[1] + a[:, 2] * theta[2]
    # of a joint that moves one way, nothing tells friction from an offset
    ways = min(float(np.mean(way * qd > TURNS * speed)) for way in (1, -1))
    size = float(np.sqrt(np.mean(torque**2)))
    excess, excess_t = _excess(
        a @ theta - torque, torque, slow.at_edge[i], float(np.sqrt(variance))
    )
    return Regression(
        slope=float(theta[0]),
        error=float(np.sqrt(max(covariance[0, 0], 0.0)) / scale[0]),
        r2=1.0 - float(left @ left) / spread,
        share=float(np.std(rigid)) / max(size, 1e-300),
        friction=(
            float(np.mean(rub * qd)) / max(float(np.mean(np.abs(qd))) * size, 1e-300)
            if ways > BOTH_WAYS
            else 0.0
        ),
        excess=excess,
        excess_t=excess_t,
        alike=repeats(left, slow.sample_time),
        held=_held(q[use], qd[use], torque[use], spread),
    )


def _held(q: Array, qd: Array, torque: Array, spread: float) -> bool:
    """Whether the torque pulls back in proportion to position and speed, and does nothing else."""
    a = np.stack([q, qd, np.ones_like(q)], axis=1)
    theta, left, *_ = np.linalg.lstsq(a, torque)
    return bool(theta[0] < 0 and theta[1] < 0 and left.sum() < (1.0 - PULLS_BACK) * spread)


def _excess(
    beyond: Array, torque: Array, at_edge: npt.NDArray[np.bool_], spread: float
) -> tuple[float, float]:
    count = int(at_edge.sum())
    if count < AT_EDGE:
        return 0.0, 0.0
    push = beyond[at_edge] * np.sign(torque[at_edge])
    mean = float(push.mean())
    error = max(float(push.std()), spread) / np.sqrt(count / 4)
    return mean / max(float(np.mean(np.abs(torque[at_edge]))), 1e-300), mean / max(
        float(error), 1e-300
    )


def check_driven(
    where: Sequence[str], records: Sequence[JointRecord], model: Model, signs: bool = True
) -> None:
    """Compare commands with motion, joint by joint.

    Parameters
    ----------
    where : sequence of str
        Name of each joint for messages.
    records : sequence of JointRecord
        All joints of one recording.
    signs : bool
        Whether a sign may be accused.

    Raises
    ------
    RecordingError
        With the likeliest mistake.
    """
    period = records[0].sample_time
    y = np.stack([r.position for r in records])
    u = np.stack([r.command for r in records])
    noise = np.array(
        [np.hypot(r.measurement.noise, r.measurement.resolution / np.sqrt(12)) for r in records]
    )
    plain = look(y, u, period, noise)
    body = rigid_body(plain, model)
    slopes: list[float] = []
    for i, name in enumerate(where):
        if not np.any(u[i]):
            continue
        found = regress(plain, model, i + 1, body)
        if found is None:
            continue
        if found.r2 > GOOD and abs(found.slope) > SURE_ERRORS * found.error:
            slopes.append(found.slope)
        if found.slope + ERRORS * found.error < LITTLE and _carried(plain, model, i + 1, body):
            continue
        if signs:
            _sign(name, found)
        if found.slope + ERRORS * found.error < LITTLE or (
            found.slope - ERRORS * found.error > MUCH and found.r2 > HALF
        ):
            kind = model.joint_kind(i + 1)
            _undo(name, found, _mistakes(y, u, noise, kind == "rotary"), period, model, i)
        top = float(np.max(np.abs(u[i])))
        stated = per_joint(model.actuator.limit, i + 1, 0.0)
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
    if not _tool(plain, model, body):
        scaled(where[0].removesuffix(": joint 1"), slopes)


def scaled(name: str, slopes: Sequence[float]) -> None:
    """Refuse where the inertias of all joints that show theirs are off by one factor (``slopes``,
    of the model's).
    """
    low, high = min(slopes, default=1.0), max(slopes, default=1.0)
    # once the factor is undone, each is as near its model's as RIGHT allows
    alike = len(slopes) > 1 and 0.0 < high < RIGHT[1] / RIGHT[0] * low
    if alike and (low > GEARED or high < 1.0 / GEARED):
        factor = math.exp(math.fsum(map(math.log, slopes)) / len(slopes))
        raise RecordingError(
            f"{name}: the inertias of all joints that show theirs come out as {low:.2g} to"
            f" {high:.2g} times the model's: divide the actuator's gain by about {factor:.2g} (a"
            " gear ratio, a torque constant, a unit of the command), or correct the model's masses"
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
    # the other way round its inertia would be below nothing, where it shows at all
    drives = -FULL < found.friction < -DRIVES and found.slope < ERRORS * error
    if sure and drives and not found.held and found.slope + ERRORS * error < LITTLE:
        raise RecordingError(
            f"{name}: friction would have to drive the joint ({100 * found.friction:.0f} % of the"
            " torque along the motion): the sign of the command or of the position is flipped"
        )


def _mistakes(
    y: Array, u: Array, noise: Array, rotary: bool
) -> list[tuple[str, tuple[Array, Array, Array]]]:
    """The likely mistakes, and position, command and noise with each of them undone."""
    small = DEGREE if rotary else 1e3
    words = "degrees, not radians" if rotary else "millimetres, not metres"
    gain = "of what the model's gain expects"
    return [
        (f"the position is in {words}", (y / small, u, noise / small)),
        (f"the command is in milli-units {gain}", (y, u / 1e3, noise)),
        (f"the command is in thousands {gain}", (y, u * 1e3, noise)),
        ("position and command are swapped", (u, y, 0 * noise)),
    ]


def _undo(
    name: str,
    found: Regression,
    mistakes: Sequence[tuple[str, tuple[Array, Array, Array]]],
    period: float,
    model: Model,
    i: int,
) -> None:
    """Name the mistake that, undone, makes recording and model agree."""
    for words, (q, command, spread) in mistakes:
        slow = look(q, command, period, spread)
        again = regress(slow, model, i + 1, rigid_body(slow, model))
        if again is None or again.share < SHOWS:
            # so read the inertia would hardly show, as it does where a joint is hardly driven at
            # all: no explanation
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
    # inertia dominates a motion that the model's inertia cannot come from: not physics that could
    # be added
    hidden = found.slope + ERRORS * found.error < NONE
    if hidden and found.share > INERTIAL_SHARE and found.r2 < HALF:
        raise RecordingError(
            f"{name}: the command does not produce this motion (it explains"
            f" {100 * max(found.r2, 0.0):.0f} % of it, and the model's inertia does not show): are"
            " the columns of different runs, joints or units?"
        )


def _carried(slow: Slow, model: Model, joint: int, body: tuple[Array, Array]) -> bool:
    """Whether a body that the model lacks, on a joint's own link, explains its torque (1-based).
    Where all joints swing, its pull may be larger than the link's own inertia, and against it.
    """
    links = _links(slow, model)
    if links is None:
        return False
    felt, a, lacking = _borne(slow, model, body, links, joint - 1, joint - 1)
    if len(a) < PER_COLUMN * a.shape[1]:
        return False
    theta, right = _solved(a, lacking, _variance(slow, model, joint - 1))
    inertia = float(np.mean(theta[: len(felt)] @ felt))  # less than none: a flipped sign
    return inertia > 0 and right


def _tool(slow: Slow, model: Model, body: tuple[Array, Array]) -> bool:
    """Whether one body on the last link, no heavier than the robot, explains what all joints
    lack.
    """
    links = _links(slow, model)
    if links is None:
        return False
    blocks, lacking, rows = [], [], []
    for i in range(len(links.bodies)):
        _, a, left = _borne(slow, model, body, links, i, len(links.bodies) - 1)
        unit = math.sqrt(_variance(slow, model, i)) or 1.0
        blocks.append(a / unit)
        lacking.append(left / unit)
        rows.append(len(left))
    shared, own = len(NUMBERS), blocks[0].shape[1] - len(NUMBERS)  # columns
    whole = np.zeros((sum(rows), shared + own * len(rows)))
    ends = np.cumsum(rows)
    for i, (a, end) in enumerate(zip(blocks, ends, strict=True)):
        whole[end - rows[i] : end, :shared] = a[:, :shared]
        whole[end - rows[i] : end, shared + own * i : shared + own * (i + 1)] = a[:, shared:]
    if len(whole) < PER_COLUMN * whole.shape[1]:
        return False
    theta, _ = _solved(whole, np.concatenate(lacking), 1.0)
    rest = np.split(np.concatenate(lacking) - whole @ theta, ends[:-1])
    explained = all(float(x @ x) < (1 - GOOD) * len(x) for x in rest)
    return explained and 0.0 < theta[0] < sum(b.mass for b in links.bodies)


def _links(slow: Slow, model: Model) -> Links | None:
    """The machine's links along the motion; None where its kind has none."""
    tree = machine_tree(model)
    states = np.stack([slow.q, slow.qd, slow.qdd], axis=1)
    return Links(tuple(tree[0]), tree[1], states) if tree is not None else None


def _borne(
    slow: Slow, model: Model, body: tuple[Array, Array], links: Links, i: int, link: int
) -> tuple[Array, Array, Array]:
    """Of joint ``i``: the inertia that each number of a link gives it; columns of the numbers,
    friction and a constant; and the torque that the model's body lacks (both from 0).
    """
    if links.moves(i, link):
        felt, borne = links.columns(i, link)
    else:
        felt, borne = np.zeros((2, len(NUMBERS), slow.q.shape[1]))
    qd, use = slow.qd[i], ~slow.at_edge[i]
    dry = np.tanh(qd / (0.1 * float(np.sqrt(np.mean(qd**2))) + 1e-300))
    a = np.stack([*borne, qd, dry, np.ones_like(qd)], axis=1)
    torque = per_joint(model.actuator.gain, i + 1, 1.0) * slow.command[i]
    return felt, a[use], (torque - body[0][i] - body[1][i])[use]


def _variance(slow: Slow, model: Model, i: int) -> float:
    """Of the torque of joint ``i`` (from 0)."""
    use = ~slow.at_edge[i]
    return float(np.var(per_joint(model.actuator.gain, i + 1, 1.0) * slow.command[i][use]))


def _solved(a: Array, lacking: Array, variance: float) -> tuple[Array, bool]:
    """Least squares, and whether it leaves little of a torque of that variance."""
    scale = np.maximum(np.linalg.norm(a, axis=0), 1e-300)
    theta = np.linalg.lstsq(a / scale, lacking, rcond=1e-9)[0] / scale
    left = lacking - a @ theta
    return theta, float(left @ left) < (1 - GOOD) * len(left) * variance


def check_free(where: Sequence[str], records: Sequence[JointRecord], model: Model) -> None:
    """A machine without a command must swing as gravity says.

    Raises
    ------
    RecordingError
        Where it swings as in degrees, or as if 0 were upright.
    """
    for name, record in zip(where, records, strict=True):
        weight = mechanism_value(model, "gravity", record.joint)
        inertia = mechanism_value(model, "inertia", record.joint)
        if model.kind != "rotary" or weight == 0 or inertia == 0:
            continue
        m = record.measurement
        noise = np.array([np.hypot(m.noise, m.resolution / np.sqrt(12))])
        ratio, r2 = _swing(record.position[None], record.sample_time, noise, inertia, weight)
        if r2 > SOUND and ratio < -LITTLE:
            raise RecordingError(
                f"{name}: the joint swings about the position pi; the model takes 0 as hanging"
                " down: add pi by [sensor] offset"
            )
        other, better = _swing(
            record.position[None] / DEGREE, record.sample_time, noise / DEGREE, inertia, weight
        )
        if r2 < SOUND < better and other > LITTLE:
            raise RecordingError(
                f"{name}: the joint swings as gravity says only if the position is in degrees;"
                " expected radians"
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
