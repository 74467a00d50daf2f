"""Static friction of the planar arm: the breakaway torque, and the stiffness of the bristles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from zendsp.errors import RecordingError
from zendsp.experiment.estimates import mean_of, smoothed
from zendsp.experiment.figures import BLUE, RED, label, make_figure, save
from zendsp.experiment.imi_friction import (
    BRAKE,
    DELAY,
    JOINTS,
    KD,
    KP,
    MACHINE,
    Array,
    inertia_torque,
    padded,
)
from zendsp.experiment.lab import Bench, Lab, push_program
from zendsp.experiment.result import Estimate, Result
from zendsp.recording import Recording

# N m, height of a torque step, and s, its length: so slow that friction reaches what it can hold
STEP, HOLD = {1: 0.01, 2: 0.004}, 0.01
# the same for the stiffness of bristles: fast against what the drive's noise lets them creep
FAST, FAST_HOLD = {1: 0.002, 2: 0.002}, 0.001
CREEP = 0.006  # of the stiffness: what they still creep, as pushes of other speeds show
ENOUGH = {1: 14.0, 2: 4.2}  # N m, to break away
CUTOFF = 25.0  # Hz, of the speed: what holds one joint must not shake the other by its noise
AWAY = 0.02  # rad/s: a joint that is faster has broken away
REACH = 1.5  # rad, of start positions
VISCOUS = {1: 5.3, 2: 1.1}  # N m s/rad, of the arm's published model
WINDOW, FAST_WINDOW = 101, 31  # samples that a slow push and a fast one are smoothed over


def static(lab: Lab, count: int = 6) -> Result:
    """Static friction: torque steps CW and CCW from several positions; the result is the mean of
    the breakaway torques.

    The positions are drawn at random, because friction varies with place: only then does the spread
    of a few torques tell how far their mean may be from that of all places.
    """
    result = Result("breakaway", "Static friction of the planar arm", MACHINE)
    found: dict[tuple[int, int], list[tuple[float, float]]] = {}
    bristles: dict[int, list[tuple[float, float]]] = {1: [], 2: []}
    early: dict[int, list[float]] = {1: [], 2: []}
    with lab.bench(result.name) as bench:
        for joint in JOINTS:
            for direction in (1, -1):
                places = lab.random.uniform(-REACH, REACH, count)
                pushes = [_break_away(bench, joint, direction, float(x)) for x in places]
                found[joint, direction] = [
                    (float(x), push.torque) for x, push in zip(places, pushes, strict=True)
                ]
                bristles[joint] += [(push.stiffness, push.apart) for push in pushes]
                early[joint] += [push.torque - push.fast_torque for push in pushes]
        result.recordings, result.target = bench.recordings, bench.where
        lost = {joint: too_early(joint, early[joint]) for joint in JOINTS}
        for joint in JOINTS:
            _report_static(result, joint, found, bristles[joint], lost[joint])
        result.figure = _draw_static(found, lost, bench)
    return result


def too_early(joint: int, apart: Sequence[float]) -> Estimate:
    """By how much a joint breaks away too early because the torque still grows meanwhile, N m.

    A joint breaks away where friction can hold no more torque. This is a fold, which under a torque
    that grows at a rate r is passed at a speed of r^(1/3). Friction falls as the square of a small
    speed, so the missing torque goes as r^(2/3), and two rates determine it. An exponent of 1/2
    would give half as much again, and 1 half as much; its standard deviation is therefore a third.

    Parameters
    ----------
    joint : int
        1 or 2.
    apart : sequence of float
        Breakaway torque of each slow push less that of the fast push at its place, N m.
    """
    faster = (FAST[joint] / FAST_HOLD) / (STEP[joint] / HOLD)
    share = 1.0 / (faster ** (2 / 3) - 1.0)
    lost = mean_of([share * x for x in apart], "N m")
    return Estimate(lost.value, float(np.hypot(lost.std, lost.value / 3)), "N m")


def _report_static(
    result: Result,
    joint: int,
    found: dict[tuple[int, int], list[tuple[float, float]]],
    bristles: list[tuple[float, float]],
    early: Estimate,
) -> None:
    """Add the breakaway torques to the result.

    Friction of both directions varies along the same path, so they share their spread. Its
    distribution over places is not normal: four places alone look too even once in ten times.
    """
    both = []
    torques = {d: [torque for _, torque in found[joint, d]] for d in (1, -1)}
    shared = float(np.hypot(STEP[joint] / np.sqrt(12), early.std))
    for direction, word in ((1, "ccw"), (-1, "cw")):
        each = mean_of(torques[direction], "N m", shared, beside=torques[-direction])
        each = Estimate(each.value + early.value, each.std, "N m")
        result.values[f"breakaway{joint}_{word}"] = each
        both.append(each)
        result.tables.setdefault("breakaway", []).append(
            {
                "joint": joint,
                "direction": word,
                "torque N m": round(each.value, 3),
                "± N m": round(each.std, 3),
                "each N m": ", ".join(f"{x:.2f}" for x in torques[direction]),
            }
        )
    result.values[f"breakaway{joint}"] = Estimate(
        float(np.mean([e.value for e in both])),
        float(np.hypot(both[0].std, both[1].std) / 2),
        "N m",
    )
    stiffness, apart = np.array(bristles).T
    slack = np.hypot(np.mean(apart), CREEP * np.mean(stiffness))
    result.values[f"stiffness{joint}"] = mean_of(stiffness, "N m/rad", float(slack))


class Push(NamedTuple):
    """The result of two pushes at a place: breakaway torque of a slow and of a fast staircase (N
    m); stiffness from the fast one (N m/rad), and the difference between two ways of reading it.
    """

    torque: float
    fast_torque: float
    stiffness: float
    apart: float


def _break_away(bench: Bench, joint: int, direction: int, position: float) -> Push:
    word = f"joint{joint}_{'ccw' if direction > 0 else 'cw'}_{position:+.3f}"
    slow = _push(bench, word, joint, direction, position, STEP[joint], HOLD)
    torque = breakaway_torque(slow, joint)
    fast = _push(bench, f"{word}_fast", joint, direction, position, FAST[joint], FAST_HOLD)
    pushed = pushed_way(fast, joint, FAST_WINDOW)
    wide, narrow = (bristle_stiffness(pushed, joint, torque, part) for part in (0.7, 0.3))
    return Push(torque, breakaway_torque(fast, joint), wide, 0.5 * (wide - narrow))


def _push(
    bench: Bench,
    name: str,
    joint: int,
    direction: int,
    position: float,
    increment: float,
    hold: float,
) -> Recording:
    start = [0.0, 0.0]
    start[joint - 1] = position
    return bench.record(
        name,
        push_program(),
        ["q", "torque", "phase"],
        seconds=3.8 + ENOUGH[joint] / increment * hold,
        joint=joint,
        direction=direction,
        place=padded(start),
        Kp=padded(KP),
        Kd=padded(KD),
        brake=padded(BRAKE),
        cutoff=CUTOFF,
        increment=increment,
        hold=hold,
        threshold=0.05,
    )


def pushed_way(rec: Recording, joint: int, window: int) -> tuple[Array, Array, Array]:
    """Way, speed and friction torque of a pushed joint, smoothed by a local parabola, as
    magnitudes.

    Friction is the torque less that which accelerates the joint.
    """
    rows = np.flatnonzero(rec["phase"] == 2)
    before = np.arange(max(0, rows[0] - 50), rows[0])
    used = np.r_[before, rows]
    dt = rec.sample_time * rec.decimation
    q, torque = rec["q"][used], rec["torque"][used] * (rec["phase"][used] == 2)
    # what acts at a sample is the mean of the commands of the two samples before it
    torque = 0.5 * (np.r_[[0.0] * DELAY, torque[:-DELAY]] + np.r_[[0.0, 0.0], torque[:-2]])
    qd, qdd = (smoothed(q, window, dt, order) for order in (1, 2))
    smooth = smoothed(q[:, joint - 1], window)
    friction = smoothed(torque, window) - inertia_torque(q, qd, qdd)[:, joint - 1]
    sign = np.sign(torque[-1])
    way = sign * (smooth - q[: len(before), joint - 1].mean())
    first = len(before)
    return way[first:], sign * qd[first:, joint - 1], sign * friction[first:]


def breakaway_torque(rec: Recording, joint: int) -> float:
    """The largest torque that friction holds, N m: the torque less its accelerating and viscous
    parts, at the maximum.

    A joint creeps before it breaks away, and gains speed while the torque goes on growing; the
    torque at a given speed would be too large.
    """
    if len(np.flatnonzero(rec["phase"] == 2)) < 2 * WINDOW:
        raise RecordingError(f"joint {joint} was pushed for less than {2 * WINDOW} samples")
    _, speed, friction = pushed_way(rec, joint, WINDOW)
    edge = WINDOW // 2
    held = (friction - VISCOUS[joint] * speed)[edge:-edge]
    most = int(np.argmax(held))
    if speed[edge:-edge].max() < AWAY:
        raise RecordingError(
            f"joint {joint} did not break away: {held.max():.3g} N m were not enough; look at the"
            " recording"
        )
    return float(held[most])


def bristle_stiffness(
    pushed: tuple[Array, Array, Array], joint: int, level: float, part: float = 0.7
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
        return np.asarray(
            level * (1 - gone) + x[1] * speed * gone + VISCOUS[joint] * speed - friction
        )

    first = part * level / max(way[-1], 1e-9) / 1e4
    return 1e4 * float(least_squares(miss, [first, 0.0, 0.0]).x[0])


def _draw_static(
    found: dict[tuple[int, int], list[tuple[float, float]]],
    early: dict[int, Estimate],
    bench: Bench,
) -> str:
    """Draw each push at its place, corrected as the mean is."""
    figure, axes = make_figure(1, 2)
    for axis, joint in zip(axes[0], JOINTS, strict=True):
        for direction, colour, word in ((1, BLUE, "counterclockwise"), (-1, RED, "clockwise")):
            positions, torques = np.array(found[joint, direction]).T
            torques = torques + early[joint].value
            axis.plot(positions, torques, "o", color=colour, label=word, markersize=6)
            axis.axhline(float(np.mean(torques)), color=colour, linewidth=0.8, linestyle="--")
        low, high = axis.get_ylim()
        axis.set_ylim(low - 0.25 * (high - low), high + 0.5 * (high - low))
        label(axis, "start position (rad)", "breakaway torque (N m)", f"joint {joint}", legend=True)
    return save(figure, bench.folder / "static.png")
