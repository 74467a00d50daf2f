"""What a push by a staircase of torque shows: the torque that friction holds, and the stiffness of
the bristles.
"""

from __future__ import annotations

import numpy as np

from zendsp.errors import Unmeasured
from zendsp.experiment.estimates import smoothed
from zendsp.experiment.joints import USED, Array, Axis, Known
from zendsp.experiment.push import PUSHING, columns
from zendsp.recording import Recording

WINDOW = 0.101  # s that a slow push is smoothed over
AWAY = 0.02  # of the low-speed peak: a joint that is faster has broken away
LARGEST = 3.0  # standard deviations, of the largest of some hundred smoothed values


def pushed_way(
    rec: Recording, known: Known, joint: int, direction: int, window: float
) -> tuple[Array, Array, Array]:
    """Way, speed and friction torque of a pushed joint, smoothed by a local parabola over
    ``window`` s, as magnitudes.

    Friction is the torque less that which accelerates the joint and that which carries its weight.
    """
    rows = np.flatnonzero(rec["phase"] == PUSHING)
    before = np.arange(max(0, rows[0] - 50), rows[0])
    used = np.r_[before, rows]
    dt = rec.sample_time
    q = columns(rec, "q", len(known.pose))[used]
    torque = rec["torque"][used]
    # what acts at a sample is the mean of the commands of the two samples before it
    torque = 0.5 * (np.r_[torque[:1], torque[:-1]] + np.r_[torque[:1], torque[:1], torque[:-2]])
    samples = 2 * round(0.5 * window / dt) + 1
    qd, qdd = (smoothed(q, samples, dt, order) for order in (1, 2))
    smooth = smoothed(q[:, joint - 1], samples)
    friction = smoothed(torque, samples) - known.other(joint, q, qd, qdd)
    way = direction * (smooth - q[: len(before), joint - 1].mean())
    first = len(before)
    return way[first:], direction * qd[first:, joint - 1], direction * friction[first:]


def breakaway_torque(
    rec: Recording, known: Known, joint: int, direction: int
) -> tuple[float, float]:
    """The largest torque that friction holds, N m: the torque less its accelerating and viscous
    parts, and less the weight as it is known, at the maximum; and by how much noise may have made
    it larger.

    A joint creeps before it breaks away, and gains speed while the torque goes on growing; the
    torque at a given speed would be too large.
    """
    axis = known.axes[joint]
    samples = 2 * round(0.5 * WINDOW / (rec.sample_time)) + 1
    if len(np.flatnonzero(rec["phase"] == PUSHING)) < 2 * samples:
        raise Unmeasured(f"joint {joint} was pushed for less than {2 * samples} samples")
    _, speed, friction = pushed_way(rec, known, joint, direction, WINDOW)
    edge = samples // 2
    held = (friction - axis.viscous * speed)[edge:-edge]
    if speed[edge:-edge].max() < AWAY * axis.pace:
        most = float(np.abs(rec["torque"][rec["phase"] == PUSHING]).max())
        raise Unmeasured(
            f"joint {joint} did not break away: pushed by up to {most:.3g} {axis.force} of its"
            f" limit of {axis.torque:.3g} {axis.force}, of which at most {USED:.0%} are used. Let"
            " the machine declare a larger torque_max, or look at the recording for what holds it"
        )
    twice = smoothed(held, 2 * samples + 1)
    return float(held.max()), float(LARGEST * np.std(held - twice))


def bristle_stiffness(
    pushed: tuple[Array, Array, Array], axis: Axis, level: float, part: float = 0.7
) -> float:
    """Stiffness of the spring that friction is before the joint slides, N m/rad, from a fast push.

    friction = level (1 - exp(-stiffness way / level)) + damping speed (Dahl 1968), for the first
    ``part`` of the breakaway torque. A slow push would measure creep instead: the noise of the
    drive shakes the joint and lets bristles slip.
    """
    from scipy.optimize import least_squares

    way, speed, friction = pushed
    last = int(np.argmax(friction > part * level)) or len(way)
    way, speed, friction = way[:last], speed[:last], friction[:last]

    def miss(x: Array) -> Array:
        gone = np.exp(-1e4 * x[0] * (way - 1e-4 * x[2]) / level)
        bent = level * (1 - gone) + x[1] * speed * gone
        return np.asarray(bent + axis.viscous * speed - friction)

    first = part * level / max(way[-1], 1e-9) / 1e4
    return 1e4 * float(least_squares(miss, [first, 0.0, 0.0]).x[0])
