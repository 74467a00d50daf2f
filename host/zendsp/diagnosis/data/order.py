"""Columns of an arm that do not belong to the joints of the model: two joints exchanged (a driver
may list them by the alphabet); a joint that counts the other way or from another zero, or of which
one column has the other sign; commands without the gravity that the drives add.

Each mistake is undone, and the torque that the given model leaves beside friction is compared
before and after. A wrong body leaves much torque too, but none of the mistakes explains it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.regression import TURNS, Slow, look, rigid_body
from zendsp.errors import RecordingError
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.model import TREES, Model, per_joint

Array = npt.NDArray[np.float64]

# of the torque's energy, as the mean over the joints: a mistake leaves 0.08 to 3.4 of it, an arm in
# order 0.001 to 0.005
AMISS_BY = 0.03
# of that energy, or of the torque's where that is less: most that is left once the mistake is
# undone. Mistakes left 0.001 to 0.04 of it; in 70 arms with wrong bodies the nearest to a mistake
# left 0.84
UNDONE = 0.1
AS_WELL = 1.01  # times what another mistake leaves, undone
COMPARED = 200  # rows of a recording, or a few more: enough for these parts of the energy


def check_order(
    where: str,
    records: Sequence[JointRecord],
    model: Model,
    beside: Sequence[Sequence[JointRecord]] = (),
) -> None:
    """Refuse columns that agree with an arm's model only in another order, sign or zero.

    Parameters
    ----------
    beside : sequence of sequence of JointRecord
        Other parts of the recording: the longest shows the same mistake, if it is longer. In a
        third of a second, in one direction, a rigid body with friction is like another one.

    Raises
    ------
    RecordingError
        Names the mistake that, undone, makes them agree.
    """
    if not (model.kind in (*TREES, "planar2r") and len(records) > 1):
        return
    before, found = _amiss(records, model)
    if not found:
        return
    longest = max(beside, key=lambda part: part[0].n, default=records)
    if longest[0].n > records[0].n:
        there = _amiss(longest, model)[1]
        found = {words: left for words, left in found.items() if words in there}
    if found:
        raise RecordingError(
            f"{where}: {', or '.join(found)}: the model leaves {100 * min(before, 1.0) ** 0.5:.0f}"
            f" % of the joints' torques, and {100 * min(found.values()) ** 0.5:.2g} % once that is"
            " undone"
        )


def _amiss(records: Sequence[JointRecord], model: Model) -> tuple[float, dict[str, float]]:
    """What the model leaves of the torques' energy; and by their words the mistakes that, undone,
    leave next to nothing of that, with what is left then.
    """
    if not all(np.ptp(r.command) for r in records):
        return 0.0, {}
    gain = np.array([per_joint(model.actuator.gain, r.joint, 1.0) for r in records])
    slow = look(
        np.stack([r.position for r in records]),
        gain[:, None] * np.stack([r.command for r in records]),
        records[0].sample_time,
        np.array([r.measurement.std for r in records]),
    )
    some = slice(None, None, max(1, slow.q.shape[1] // COMPARED))
    q, qd, qdd, command = (x[:, some] for x in (slow.q, slow.qd, slow.qdd, slow.command))
    slow = replace(slow, q=q, qd=qd, qdd=qdd, command=command)
    before = _left(slow, rigid_body(slow, model))
    if before < AMISS_BY:
        return before, {}
    mistakes = list(_mistakes(slow, model))
    bodies = _rigid_bodies([undone for _, undone, _ in mistakes], model)
    tried = [
        (_left(undone, body, weight), words)
        for (words, undone, weight), body in zip(mistakes, bodies, strict=True)
    ]
    after = min(left for left, _ in tried)
    if after >= UNDONE * min(before, 1.0):
        return before, {}
    # a plane arm without gravity is the same with either joint mirrored
    return before, {words: left for left, words in tried if left < AS_WELL * after}


def _mistakes(slow: Slow, model: Model) -> Iterator[tuple[str, Slow, float]]:
    """Each mistake in words, the columns without it, and the part of gravity in the torques."""
    joints = range(len(slow.q))

    def moved(order: list[int], sign: Array, turn: Array) -> Slow:
        q, qd, qdd = (sign * x[order] for x in (slow.q, slow.qd, slow.qdd))
        return replace(slow, q=q + turn, qd=qd, qdd=qdd)

    as_it_is, none = np.ones((len(joints), 1)), np.zeros((len(joints), 1))
    for i, j in itertools.combinations(joints, 2):
        order = list(joints)
        order[i], order[j] = j, i
        names = f"joints {i + 1} and {j + 1}"
        positions, command = moved(order, as_it_is, none), slow.command[order]
        yield (
            f"the columns of {names} are exchanged (a driver may list joints by the alphabet)",
            replace(positions, command=command), 1.0,
        )  # fmt: skip
        yield f"the positions of {names} are exchanged", positions, 1.0
        yield f"the commands of {names} are exchanged", replace(slow, command=command), 1.0
    for j in joints:
        own = np.arange(len(joints))[:, None] == j
        sign = np.where(own, -1.0, 1.0)
        words = f"joint {j + 1} counts the other way than in the model (position and command)"
        other_way = moved(list(joints), sign, none)
        yield words, replace(other_way, command=sign * slow.command), 1.0
        yield f"the position of joint {j + 1} has the other sign", other_way, 1.0
        reversed_command = replace(slow, command=sign * slow.command)
        yield f"the command of joint {j + 1} has the other sign", reversed_command, 1.0
        if model.joint_kind(j + 1) == "rotary":
            for quarter in (1, 2, 3):
                away = math.remainder(quarter * math.pi / 2, 2 * math.pi)
                words = f"the zero of joint {j + 1} lies elsewhere ([sensor] offset = {away:.4g})"
                yield words, moved(list(joints), as_it_is, np.where(own, away, 0.0)), 1.0
    for j in joints[1:]:
        q, qd, qdd = (x.copy() for x in (slow.q, slow.qd, slow.qdd))
        for x in (q, qd, qdd):
            x[j] -= x[j - 1]
        relative = replace(slow, q=q, qd=qd, qdd=qdd)
        from_base = f"joint {j + 1} counts from the base, not from joint {j}"
        row = f"[sensor] matrix = {_plus(model.sensor.matrix, joints, j, j - 1, -1)}"
        yield f"{from_base} ({row})", relative, 1.0
        torques = slow.command.copy()
        torques[j - 1] += torques[j]
        rows = f"{row}, [actuator] matrix = {_plus(model.actuator.matrix, joints, j - 1, j, 1)}"
        driven = f"{from_base}, as driven through a parallelogram ({rows})"
        yield driven, replace(relative, command=torques), 1.0
    words = (
        "the command is without gravity, which the drives seem to add: put the model's gravity"
        " along the motion into the column, or record the whole torque"
    )
    yield words, slow, 0.0


def _plus(
    matrix: Sequence[Sequence[float]], joints: range, row: int, of: int, factor: float
) -> list[list[float]]:
    """A model's matrix (of ones where it has none) with ``factor`` times a row added to another."""
    out = np.array(matrix) if len(matrix) else np.eye(len(joints))
    out[row] += factor * out[of]
    return [[float(f"{x:.6g}") for x in each] for each in out]


def _rigid_bodies(motions: Sequence[Slow], model: Model) -> Iterator[tuple[Array, Array]]:
    """The torques of ``rigid_body`` for each of some motions of as many rows, worked out together:
    of 81 mistakes of six joints, each had taken as long as 4000 rows do.
    """
    q, qd, qdd = (
        np.concatenate([getattr(m, name) for m in motions], axis=1) for name in ("q", "qd", "qdd")
    )
    whole = rigid_body(replace(motions[0], q=q, qd=qd, qdd=qdd), model)
    return zip(*(np.split(part, len(motions), axis=1) for part in whole), strict=True)


def _left(slow: Slow, body: tuple[Array, Array], weight: float = 1.0) -> float:
    """The part of the torques' energy that a rigid ``body`` leaves beside friction: the mean over
    the joints.
    """
    rigid, gravity = body
    parts = []
    for j, torque in enumerate(slow.command):
        qd = slow.qd[j]
        speed = float(np.sqrt(np.mean(qd**2)))
        columns = np.stack([qd, np.tanh(qd / (TURNS * speed + 1e-300)), np.ones_like(qd)], axis=1)
        lacks = torque - rigid[j] - weight * gravity[j]
        theta, *_ = np.linalg.lstsq(columns, lacks)
        whole = float(np.sum((torque - torque.mean()) ** 2))
        parts.append(float(np.sum((lacks - columns @ theta) ** 2)) / max(whole, 1e-300))
    return float(np.mean(parts))
