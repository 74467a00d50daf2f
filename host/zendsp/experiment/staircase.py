"""Pushes of a joint by a staircase of torque, and what they show: whether one that does not move
stands at a stop, the torque that friction holds, and the stiffness of the bristles.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from zendsp.errors import Unmeasured
from zendsp.experiment.estimates import smoothed
from zendsp.experiment.joints import USED, Array, Axis, Known, Load
from zendsp.experiment.push import BRAKING, PUSHING, Pusher, columns
from zendsp.recording import Recording

# s, length of a torque step: so slow that friction reaches what it can hold
HOLD = 0.01
CUTOFF = 25.0  # Hz, of the speed: what holds one joint must not shake the other by its noise
THRESHOLD = 0.05  # of the low-speed way: that a joint goes before a push ends
BROKE = 0.25  # of that way: a joint that went as far has broken away …
STOOD = 0.1  # … and by less of what it went it stands, in the last third of the torque
# times what breaks a joint away the other way: friction of the two directions differs by up to 2.4
# on the shipped machines (joint 5 of the WAM)
ONE_WAY = 2.5
SURE = 3.0  # deviations that a weight may be off by
WINDOW = 0.101  # s that a slow push is smoothed over
AWAY = 0.02  # of the low-speed peak: a joint that is faster has broken away
LARGEST = 3.0  # standard deviations, of the largest of some hundred smoothed values


class Steps(NamedTuple):
    """A staircase: of which joint, in which direction and from where; by how much the torque grows,
    N m/s, in steps of how many s; and how far, N m.
    """

    joint: int
    direction: int
    place: float
    rate: float
    hold: float
    enough: float


def staircase(pusher: Pusher, name: str, steps: Steps, eased: float = 0.0) -> Recording:
    """A push whose torque grows until the joint goes: from what holds a joint that carries a
    weight, less ``eased``.
    """
    axis = pusher.known.axes[steps.joint]
    held = axis.torque if axis.load.weighs else 0.0
    return pusher.push(
        name, steps.joint, steps.direction, steps.place, (steps.enough + eased) / steps.rate,
        cutoff=CUTOFF, resting=held, band=held, eased=eased, increment=steps.rate * steps.hold,
        hold=steps.hold, threshold=THRESHOLD * axis.travel, back=THRESHOLD * axis.travel,
    )  # fmt: skip


def one_way(pusher: Pusher, name: str, tried: Steps, stood: Recording) -> float:
    """How far a joint may still be pushed that stood under a push, N m: it is pushed as far the
    other way. Infinite where it stands there too.

    Raises
    ------
    Unmeasured
        It goes the other way, by so much less that it stands at a stop.
    """
    axis = pusher.known.axes[tried.joint]
    rec = staircase(pusher, name, tried._replace(direction=-tried.direction))
    if not (rec["phase"] >= BRAKING).any():
        return float("inf")
    torque, q = _left(rec, axis)
    unsure = SURE * _weight_std(axis.load, q)
    broke = abs(torque - float(axis.load.weight(np.array(q)))) + unsure
    began, place = _ends(stood, axis)[0]
    first = float(np.asarray(stood.parameters["first"]))
    kept = tried.direction * (began - float(axis.load.weight(np.array(place)))) - first
    may = ONE_WAY * max(broke, axis.level) + unsure - kept
    if tried.enough < may:
        return may
    force, most = axis.force, float(_ends(stood, axis)[-1][0])
    how = f"by {most:.3g} {force} it does not move, and the other way it goes by {torque:.3g}"
    raise _held_up(axis, place, f"{how} {force}")


def _held_up(axis: Axis, place: float, how: str) -> Unmeasured:
    unit = axis.unit
    return Unmeasured(
        f"something holds joint {axis.number} up at {place:.3g} {unit}, within its range of"
        f" {axis.low:.3g} to {axis.high:.3g}: {how}. No more was tried. Take away what it touches,"
        " or let the machine declare the range that it has"
    )


def _left(rec: Recording, axis: Axis) -> tuple[float, float]:
    """Torque and place at which a pushed joint left its place."""
    rows = np.flatnonzero(rec["phase"] == PUSHING)
    q = rec["q"].reshape(len(rec), -1)[rows, axis.number - 1]
    at = int(np.argmax(np.abs(q - q[0]) > BROKE * THRESHOLD * axis.travel))
    return float(rec["torque"][rows[at]]), float(q[at])


def went(rec: Recording, axis: Axis) -> bool:
    """Whether a pushed joint has gone farther than bristles bend."""
    (_, first), (_, last) = _ends(rec, axis)
    return abs(last - first) > BROKE * THRESHOLD * axis.travel


def began_at(rec: Recording, axis: Axis) -> float:
    """Torque at which a push began, N m."""
    return _ends(rec, axis)[0][0]


def _ends(rec: Recording, axis: Axis) -> tuple[tuple[float, float], tuple[float, float]]:
    """Torque and place at the first and at the last row of a push."""
    rows = np.flatnonzero(rec["phase"] == PUSHING)
    q = rec["q"].reshape(len(rec), -1)[:, axis.number - 1]
    first, last = ((float(rec["torque"][k]), float(q[k])) for k in (rows[0], rows[-1]))
    return first, last


def _weight_std(load: Load, q: float) -> float:
    """Standard deviation of a joint's weight at a place, which may lie beyond the way on which it
    was measured.
    """
    return max(load.weight_std, float(np.hypot(load.cos_std * np.cos(q), load.sin_std * np.sin(q))))


def refuse_held_up(rec: Recording, axis: Axis, direction: int) -> None:
    """Refuse a staircase whose joint broke away, and then stood while the torque grew by half.

    Raises
    ------
    Unmeasured
    """
    rows = np.flatnonzero(rec["phase"] == PUSHING)
    q = rec["q"].reshape(len(rec), -1)[rows, axis.number - 1]
    way = direction * (q - q[0])
    last = way[2 * len(way) // 3 :]
    if went(rec, axis) and way[-1] > 0.0 and np.ptp(last) < STOOD * way[-1]:
        most, unit = abs(float(rec["torque"][rows[-1]])), axis.unit
        how = f"it broke away, went {way[-1]:.2g} {unit}, and stands there under up to {most:.3g}"
        raise _held_up(axis, float(q[-1]), f"{how} {axis.force}")


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
