"""A joint's torque regressed on the torque of the model's rigid body along the measured motion.

Both sides pass the same low-pass, below about 20 Hz (Gautier and Khalil 1990). The coefficient of
the rigid body is 1 where recording and model agree; missing friction, springs and offsets have
columns of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.series import repeats
from zendsp.physics.calibration.joint import mechanism_value
from zendsp.physics.kernel.smooth import gaussian
from zendsp.physics.model import TREES, Model, per_joint
from zendsp.physics.robots.rigid import bases, tree_torques
from zendsp.physics.term_numbers import added_inertia

Array = npt.NDArray[np.float64]

CUTOFFS_HZ = (20.0, 10.0, 5.0, 2.5)  # Hz
EDGE = 0.999  # of the largest command: counts as at it
QUIET = 0.1  # of the acceleration: noise below does not matter
ANGLE_SPAN = 0.2  # rad: over less, sine and cosine of the angle are almost linear
PER_COLUMN = 4  # samples at least for each column of a regression
IN_NOISE = 0.2  # of the energy that only inertia has: this much noise lowers a slope by as much
AT_EDGE = 12  # least samples at the largest command
PULLS_BACK = 0.95  # R^2 of a command by position and speed alone: it holds the joint
TURNS = 0.1  # of the RMS speed: slower is a reversal
BOTH_WAYS = 0.1  # of the time: least motion either way for friction to show


@dataclass(frozen=True)
class Slow:
    """All joints of one recording below the cutoff, thinned: arrays (joints, n); ``at_edge`` marks
    commands at their largest value, ``noise`` is that of the accelerations, (joints,).
    """

    q: Array
    qd: Array
    qdd: Array
    command: Array
    at_edge: npt.NDArray[np.bool_]
    noise: Array
    sample_time: float  # s, between the thinned samples


@dataclass(frozen=True)
class Regression:
    """Torque = slope · rigid body + friction + spring + offset: slope with its standard error, R²,
    torque of the friction columns over the RMS torque.

    ``share``: RMS of the model's rigid-body torque over that of the command. ``excess``: missing
    torque at the largest commands over that command. ``alike``: residual samples that count as one
    independent sample. ``held``: the command is that of a controller that holds the joint in place
    while others move it, and the friction columns show that controller.
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


def look(
    positions: Array,
    commands: Array,
    sample_time: float,
    noise: Array,
    cutoffs: Sequence[float] = CUTOFFS_HZ,
) -> Slow:
    """Motion and commands below a cutoff, thinned.

    Parameters
    ----------
    positions, commands : ndarray, shape (joints, n)
        rad or m; command units.
    sample_time : float
        s.
    noise : ndarray, shape (joints,)
        Standard deviation of the position's noise, rad or m: the cutoff falls until its share of
        the acceleration does not matter.
    cutoffs : sequence of float
        Hz, falling.
    """
    nyquist = 0.5 / sample_time
    for cutoff in cutoffs:
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
    return Slow(
        q[:, use], qd[:, use], qdd[:, use], u[:, use], solid[:, use], white, step * sample_time
    )


def rigid_torques(model: Model, states: Sequence[Array]) -> Array:
    """Torques of a model's rigid body, its gravity included, along the q, qd, qdd of each joint,
    (joints, n); without rotors beside it.
    """
    if model.kind in TREES and model.called is None:  # whose inertias nobody asks for
        return tree_torques(model, list(states))
    out = np.zeros((len(states), states[0].shape[1]))
    for i, basis in enumerate(bases(model, list(states))):
        for key, part in basis.items():
            value = 1.0 if key == "fixed" else mechanism_value(model, key, i + 1)
            out[i] += value * (part.inertia * states[i][2] + part.bias)
    return out


def rigid_body(slow: Slow, model: Model) -> tuple[Array, Array]:
    """Torques of the model's rigid body along a motion: without gravity, and of gravity where the
    mechanism has it, (joints, n) each.
    """
    rest = np.zeros_like(slow.q)
    states = list(np.stack([slow.q, slow.qd, slow.qdd], axis=1))
    weight = (
        rigid_torques(model, list(np.stack([slow.q, rest, rest], axis=1)))
        if model.kind in TREES
        else rest
    )
    rigid = rigid_torques(model, states) - weight
    for j in range(len(rigid)):
        rigid[j] += added_inertia(model, j + 1) * slow.qdd[j]
    return rigid, weight


def regress(slow: Slow, model: Model, joint: int, body: tuple[Array, Array]) -> Regression | None:
    """The regression of one joint's torque (1-based) on its rigid ``body``; None where there are
    too few samples or nothing varies.
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
    # for a joint that moves one way, friction and an offset cannot be separated
    ways = min(float(np.mean(way * qd > TURNS * speed)) for way in (1, -1))
    size = float(np.sqrt(np.mean(torque**2)))
    noise = slow.noise[i] * float(np.std(rigid) / max(np.std(slow.qdd[i]), 1e-300))
    blurred = _blurred(a[use] / scale, noise / scale[0])
    excess, excess_t = _excess(
        a @ theta - torque, torque, slow.at_edge[i], float(np.sqrt(variance))
    )
    return Regression(
        slope=float(theta[0]),
        error=math.inf if blurred else float(np.sqrt(max(covariance[0, 0], 0.0)) / scale[0]),
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
        held=_held(q[use], qd[use], weight[use], torque[use], spread),
    )


def _blurred(columns: Array, noise: float) -> bool:
    """Whether the part of the first column that the others do not explain is ``noise`` (RMS). In a
    single sine acceleration is proportional to position, so its slope would be determined by noise.
    """
    others, *_ = np.linalg.lstsq(columns[:, 1:], columns[:, 0])
    own = columns[:, 0] - columns[:, 1:] @ others
    # not their squares, which could overflow for a resting joint
    return bool(math.sqrt(len(own)) * noise > math.sqrt(IN_NOISE) * float(np.linalg.norm(own)))


def _held(q: Array, qd: Array, weight: Array, torque: Array, spread: float) -> bool:
    """Whether the torque is only a feedback of position and speed plus the model's gravity."""
    columns = [q, qd, np.ones_like(q), *([weight] if np.any(weight) else [])]
    theta, left, *_ = np.linalg.lstsq(np.stack(columns, axis=1), torque)
    back = theta[0] < 0 and theta[1] < 0 and all(borne > 0 for borne in theta[3:])
    return bool(back and left.sum() < (1.0 - PULLS_BACK) * spread)


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
