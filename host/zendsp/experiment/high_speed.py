"""Sliding friction at high speed: constant torque, open loop, until the speed is steady."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from zendsp.errors import Unmeasured
from zendsp.experiment.estimates import NORMAL, line_fit
from zendsp.experiment.figures import BLUE, GREY, label, make_figure, save
from zendsp.experiment.joints import USED, Axis, Known
from zendsp.experiment.knowing import (
    PROGRAM,
    as_found,
    refuse_none,
    shipped,
    top_speed,
    with_values,
)
from zendsp.experiment.lab import Bench, Lab
from zendsp.experiment.low_speed import ACTS, low_speed
from zendsp.experiment.push import BRAKING, PUSHING, Pusher, columns
from zendsp.experiment.result import Estimate, Result
from zendsp.experiment.staircase import HOLD, Steps, one_way, refuse_held_up, went
from zendsp.experiment.watch import left_out, name_yielding

CERTAIN = 0.3  # of the friction: what may be uncertain of a weight that is taken off
TRIES = 5  # at a larger torque, of a joint that does not move
SETTLES = 6.0  # time constants, of a push that a range does not end …
LONGEST = 15.0  # … but s at the most
LEARNS = 4.0  # times, that the slope of friction may differ from what low speeds show
STIFFER = 2.4  # than elsewhere: what holds the others
FROM, TO = (0.0625, 0.3125), (0.719, 0.969)  # of the second half of a way: a part begins, and ends


class Point(NamedTuple):
    """Mean speed, friction and acceleration over a part of a way; how far the other joints were
    from their places, rad; and the way.
    """

    speed: float
    friction: float
    acceleration: float
    others: float
    way: float


def high_speed(
    lab: Lab, speeds: tuple[float, ...] = (), joints: tuple[int, ...] = ()
) -> Result:
    """Friction at high speed: a constant torque, open loop, until the speed is steady. What carries
    a weight comes on top of it.

    Parameters
    ----------
    lab : Lab
    speeds : tuple of float
        Which the torques shall give, rad/s or m/s; default: by the joint's limits.
    joints : tuple of int
        Which; default: all that have a drive.
    """
    arm, low = shipped(lab), None
    if arm is None:
        own = [(f"peak{j}",) for j in joints]
        low = with_values(lab, "low-speed", lambda lab: low_speed(lab, joints=joints), own)
    of = " of the planar arm" if arm is not None else ""
    result = Result("high-speed", f"Friction{of} at high speed", lab.machine_of("high-speed"))
    points: dict[int, list[Point]] = {}
    with lab.bench(result.name, result) as bench:
        known = as_found(bench, lab, low)
        pusher = Pusher(bench, known)
        for joint in joints or known.axes:
            axis = known.axes[joint]
            axis = replace(axis, speeds=speeds or axis.speeds)
            why = _unfit(axis)
            if low is not None and f"level{joint}" not in low.values:
                why = "low-speed does not tell its friction; the result of low-speed says why"
            if why:
                result.warnings.append(f"Joint {joint} is left out: {why}.")
                continue
            with left_out(result, bench.target, joint):
                points[joint] = each = _points(pusher, lab, axis, arm is None)
                _report(result, known.axes[joint], each)
                way = min(abs(p.way) for p in each)
                for k in known.axes.keys() - {joint}:
                    most = max(push.get(k, 0.0) for push in pusher.gave[joint])
                    name_yielding(result, joint, way, {k: most})
        result.recordings, result.target = bench.recordings, bench.where
        refuse_none(result, points)
        if arm is not None and 1 in points:
            result.warnings.append(
                "Joint 1 crosses its range of 4 rad before its transient of 0.75 s has quite ended:"
                f" up to {max(abs(p.acceleration) for p in points[1]):.2g} rad/s² are left, and"
                " their inertia torque is subtracted. The paper waits for the end of the transient."
            )
        drawn = {j: (known.axes[j], each) for j, each in points.items()}
        result.figure = _draw(drawn, result, bench)
    return result


def _unfit(axis: Axis) -> str:
    """Why a joint cannot be pushed at constant torque; empty where it can."""
    load = axis.load
    if load.weight_std > CERTAIN * axis.level:
        return (
            f"it carries {load.most:.3g} ± {load.weight_std:.2g} {axis.force} beside a friction of"
            f" {axis.level:.2g}: its weight is not known well enough to be taken off. A model"
            " (--model FILE) states it"
        )
    if not axis.speeds:
        top, why = top_speed(axis)
        return (
            f"{why} leaves it {max(top, 0.0):.3g} {axis.unit}/s, and low-speed goes to"
            f" {axis.pace:.3g} already. Let the machine declare more where it can, give the speeds"
            " yourself (in Python), or take what low-speed found"
        )
    return ""


def _points(pusher: Pusher, lab: Lab, axis: Axis, learns: bool) -> list[Point]:
    """A push for each speed and direction. Of a machine that is not the shipped one each torque is
    chosen by the friction that those before it found.
    """
    points: list[Point] = []
    for direction in (1, -1):
        level = axis.level + direction * axis.load.uneven
        slope, last = axis.viscous, (axis.pace, level + axis.viscous * axis.pace)
        for speed in axis.speeds:
            # friction varies with place: parts of the way that differ make that visible
            part = lab.random.uniform(*FROM), lab.random.uniform(*TO)
            torque = level + axis.viscous * speed
            if learns:
                torque = last[1] + slope * (speed - last[0])
            point = _steady(pusher, axis, direction, torque, speed, part)
            points.append(point)
            met = abs(point.speed), abs(point.friction)
            if abs(met[0] - last[0]) > 0.1 * last[0]:
                slope = float(np.clip((met[1] - last[1]) / (met[0] - last[0]),
                                      axis.viscous / LEARNS, axis.viscous * LEARNS))  # fmt: skip
            last = met
    return points


def _way(axis: Axis, speed: float, direction: int) -> tuple[float, float, float]:
    """Start, end and the middle of a push."""
    if axis.way != (0.0, 0.0):
        start, end = (direction * x for x in axis.way)
        return start, end, 0.0
    room = axis.high - axis.low
    settles = axis.load.inertia / max(axis.viscous, 1e-9)
    length = min(0.7 * room, speed * min(SETTLES * settles, LONGEST))
    middle = float(np.clip(axis.middle, axis.low + 0.6 * length + 0.05 * room,
                           axis.high - 0.6 * length - 0.05 * room))  # fmt: skip
    middle = middle if room < 100.0 * axis.travel or not np.isfinite(room) else axis.middle
    return middle - direction * 0.5 * length, middle + direction * 0.5 * length, middle


def _steady(
    pusher: Pusher,
    axis: Axis,
    direction: int,
    torque: float,
    speed: float,
    part: tuple[float, float],
) -> Point:
    """Push a joint until its way is done, and take the means over a part of its second half."""
    known, j = pusher.known, axis.number - 1
    start, end, middle = _way(axis, speed, direction)
    seconds = 2.0 * abs(end - start) / speed + axis.load.inertia / max(axis.viscous, 1e-9)
    most = USED * axis.torque - axis.load.most
    for _ in range(TRIES):
        rec = pusher.push(
            f"joint{axis.number}_{direction * torque:+.3g}{axis.force.replace(' ', '')}",
            axis.number, direction, start, min(max(seconds, 4.5), 4.0 * LONGEST),
            first=min(torque, most), lower=min(start, end) if direction < 0 else axis.low,
            upper=max(start, end) if direction > 0 else axis.high,
            back=0.1 * axis.travel, pace=speed, resting=axis.torque if axis.load.weighs else 0.0,
            **_held(known),
        )  # fmt: skip
        if (rec["phase"] >= BRAKING).any():
            break
        refuse_held_up(rec, axis, direction)
        if not went(rec, axis):
            steps = Steps(axis.number, direction, start, axis.slow, HOLD, min(torque, most))
            most = min(most, one_way(pusher, f"joint{axis.number}_back", steps, rec))
        torque *= 1.25
    q = columns(rec, "q", len(known.pose))
    way = (q[:, j] - middle) * direction
    half = abs(end - middle)
    rows = np.flatnonzero(
        (rec["phase"] == PUSHING) & (way < part[1] * half) & (way > part[0] * half)
    )
    if len(rows) < 20:
        raise Unmeasured(
            f"joint {axis.number} did not come to {middle + direction * part[1] * half:.3g}"
            f" {axis.unit} by {min(torque, most):.3g} {axis.force}, of at most {most:.3g} beside"
            " its weight; look at the recording for what holds it, or let the machine declare a"
            " larger torque_max"
        )
    t = rec.t[rows] - rec.t[rows].mean()
    quadratic, slope, _ = np.polyfit(t, q[rows, j], 2)
    v, a = np.zeros((len(rows), q.shape[1])), np.zeros((len(rows), q.shape[1]))
    v[:, j], a[:, j] = slope, 2 * quadratic
    # what acts at a sample is the mean of the commands of the two samples before it
    tau = np.interp(rec.t[rows] - ACTS * rec.sample_time, rec.t, rec["torque"])
    friction = (tau - known.other(axis.number, q[rows], v, a)).mean()
    away = np.delete(q[rows] - known.pose, j, axis=1)
    others = 0.0 if known.rigid is not None else float(np.abs(away).max(initial=0.0))
    return Point(float(slope), float(friction), float(2 * quadratic), others, end - start)


def _held(known: Known) -> dict[str, list[float]]:
    """Gains that hold the others while one swings fast: stiffer, as far as a filter of 80 Hz bears
    it. The shipped arm has its own.
    """
    if known.program != PROGRAM:
        return {}
    return {
        "Kp": [STIFFER**2 * x for x in known.gain("kp")],
        "Kd": [STIFFER * x for x in known.gain("kd")],
    }


def _report(result: Result, axis: Axis, points: list[Point]) -> None:
    """The line of each direction, with the points; and the mean of both lines."""
    j, force = axis.number, axis.force
    slope_unit = f"{force} s/{axis.unit}"
    lines = []
    left = float(np.mean([abs(p.acceleration) for p in points]))
    others = float(np.mean([p.others for p in points]))
    for direction in (1, -1):
        chosen = np.array([p[:2] for p in points if np.sign(p.speed) == direction])
        (level, slope), half, _ = line_fit(chosen[:, 0], chosen[:, 1])
        # what is wrong with inertia and weight, and what the others' places change of them
        wrong = (axis.load.inertia_std * left, axis.load.weight_std, axis.load.most * others)
        shared = float(np.linalg.norm(wrong))
        std = float(np.hypot(half[0] / NORMAL, shared))
        across = float(np.ptp(np.abs(chosen[:, 0])))
        word = axis.word(direction)
        result.values[f"viscous{j}_{word}"] = Estimate(
            float(slope), float(np.hypot(half[1] / NORMAL, shared / across)), slope_unit
        )
        result.values[f"level{j}_{word}"] = Estimate(float(level), std, force)
        lines.append((level, slope))
    level, slope = np.mean(lines, axis=0)
    ends = [result.values[f"{name}{j}_{axis.word(1)}"] for name in ("level", "viscous")]
    result.values[f"level{j}"] = Estimate(float(level), ends[0].std, force)
    result.values[f"viscous{j}"] = Estimate(float(slope), ends[1].std, slope_unit)
    if axis.load.weighs and axis.load.weight_std:
        for name, direction in itertools.product(("level", "viscous"), (1, -1)):
            del result.values[f"{name}{j}_{axis.word(direction)}"]
        result.warnings.append(
            f"Joint {j} carries a weight that only its motion has shown. What is wrong with it is"
            " larger friction in one direction and smaller in the other: the means of both are"
            " given. A model (--model) tells the directions apart."
        )
    result.tables.setdefault("points", []).extend(
        {
            "joint": j,
            f"speed {axis.unit}/s": round(p.speed, 4),
            f"friction {force}": float(f"{p.friction:.6g}"),
            f"acceleration {axis.unit}/s^2": round(p.acceleration, 3),
        }
        for p in points
    )


def _draw(
    drawn: Mapping[int, tuple[Axis, list[Point]]], result: Result, bench: Bench
) -> str:
    columns = min(3, len(drawn))
    figure, axes = make_figure(-(-len(drawn) // columns), columns, width=max(4.5 * columns, 6.0))
    for panel, (joint, (axis, points)) in zip(axes.flat, drawn.items(), strict=False):
        v, f, *_ = np.array(points).T
        panel.plot(v, f, "o", color=BLUE, markersize=5, label="measured")
        for direction in (1, -1):
            word, values = axis.word(direction), result.values
            level, slope = (
                values.get(f"{name}{joint}_{word}", values[f"{name}{joint}"]).value
                for name in ("level", "viscous")
            )
            x = np.array([0.0, direction * np.abs(v).max()])
            line = direction * (level + slope * np.abs(x))
            panel.plot(
                x, line, color=GREY, linewidth=1.0, linestyle="--",
                label="line" if direction > 0 else None,
            )  # fmt: skip
        what = "torque" if axis.unit == "rad" else "force"
        label(panel, f"speed ({axis.unit}/s)", f"friction {what} ({axis.force})",
              f"joint {joint}", legend=True)  # fmt: skip
    for panel in axes.flat[len(drawn) :]:
        panel.set_visible(False)
    return save(figure, bench.folder / "viscous.png")
