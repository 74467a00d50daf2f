"""Sliding friction at low speed along a triangular velocity; and from the same recording what each
joint moves: its inertia and its weight.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from zendsp.errors import Unmeasured
from zendsp.experiment.demand import within_drive
from zendsp.experiment.estimates import NORMAL, least_squares, smoothed, widest
from zendsp.experiment.figures import AMBER, BLUE, label, make_figure, save
from zendsp.experiment.gentle import gentle_first, stride_of
from zendsp.experiment.joints import Array, Axis, Known, Load
from zendsp.experiment.knowing import PROGRAM, first_look, refuse_none, shipped, with_loads
from zendsp.experiment.lab import Bench, Lab, playing
from zendsp.experiment.moved import NO_CHANCE, Moved, contradicting, measured_load
from zendsp.experiment.push import travel_time
from zendsp.experiment.result import Estimate, Result
from zendsp.experiment.watch import left_out, stood, widen
from zendsp.recording import Recording
from zendsp.reference import Reference
from zendsp.reference.profiles import integrate_velocity, make_grid
from zendsp.whole_file import writing

Mask = npt.NDArray[np.bool_]

NEAR = 0.02  # of the peak: speeds of the curve that one row of its table is the mean of
AT = (-0.9, -0.5, -0.2, -0.1, 0.1, 0.2, 0.5, 0.9)  # of the peak: speeds of the table
SMOOTH = 0.041  # s, of the local parabola
ACTS = 1.5  # samples from a command to the middle of what it does
QUICKER = 2.5  # speed of the quick triangles over that of the slow ones
QUICK = 4  # cycles of them
LEAST, SURELY, PEAK = 0.05, 0.4, 0.95  # of the peak: speeds that the load is fitted to
QUIET = 0.2  # of the acceleration, what the encoder's counts may add to it
SETTLES = 0.08  # s, a quarter of a swing of joint_pd.c, after a jump of the acceleration
FEWEST = 20  # points of the curve at which the joint slides
PARTS = 20  # of the speed: each is one measurement of the line that friction ends in


class Triangles(NamedTuple):
    """A motion of one joint: slow triangles and then, where any, quick ones of the same way; the
    rows of a cycle of each.
    """

    reference: Reference
    slow: int
    quick: int
    stride: int  # samples a row


@dataclass(frozen=True)
class Curve:
    """Speed, friction and where the joint loses speed, over the slow triangles; the load; and that
    of the model where the motion contradicts it.
    """

    speed: Array
    friction: Array
    slowing: Mask
    load: Load
    model: Load | None = None

    def slid(self, axis: Axis) -> Mask:
        """Rows at which the joint surely slides."""
        pace = np.abs(self.speed) / axis.pace
        return self.slowing & (pace > LEAST) & (pace < PEAK)


def low_speed(lab: Lab, cycles: int = 6, joints: tuple[int, ...] = ()) -> Result:
    """Friction at low speed: a triangular velocity up and down, both ways, repeated and averaged.

    Inertia and weight are those of the model where there is one. Otherwise quick triangles follow
    the slow ones, and both are fitted together with friction.

    Parameters
    ----------
    lab : Lab
    cycles : int
        Of the slow triangles that are averaged.
    joints : tuple of int
        Which; default: all that have a drive.
    """
    arm = shipped(lab)
    machine = lab.machine_of("low-speed")
    title = "of the planar arm " if arm is not None else ""
    result = Result("low-speed", f"Friction {title}at low speed", machine)
    curves: dict[int, tuple[Axis, Curve]] = {}
    with lab.bench(result.name, result) as bench:
        known = arm or first_look(bench, lab)
        period = 1e-3 if arm is not None else 1.0 / bench.target.status().rate_hz
        for joint in joints or known.axes:
            with left_out(result, bench.target, joint):
                axis, values = _paced(bench, known, joint, (cycles, period), result)
                motion = triangles(axis, known, cycles, period)
                rec = _recorded(bench, known, axis, motion, values)
                curve = friction_curve(rec, known, axis, motion)
                curves[joint] = axis, curve
                _report(result, known, axis, curve)
                if known.program == PROGRAM:
                    names = [f"{name}{joint}" for name in ("inertia", "level", "slope")]
                    seen = bench.seen
                    widen(result, joint, seen, bench.inertias, names, seen[joint].quick)
                file = bench.folder / f"curve{joint}.npz"
                with writing(file):
                    np.savez(
                        file, speed=curve.speed, friction=curve.friction, slowing=curve.slowing
                    )
        refuse_none(result, curves)
        result.recordings, result.target = bench.recordings, bench.where
        for number, place in enumerate(known.pose, start=1):
            result.values[f"place{number}"] = Estimate(float(place), 0.0, _unit(known, number))
        result.figure = _draw(curves, cycles, bench)
    return result


def _paced(
    bench: Bench, known: Known, joint: int, asked: tuple[int, float], result: Result
) -> tuple[Axis, dict[str, Any]]:
    """A joint with the pace that its drive can give it, and parameters of the loop. One that is not
    the shipped machine's moves gently before, which tells both.
    """
    axis, values = known.axes[joint], dict(known.values)
    if known.program != PROGRAM:
        return axis, values
    values["J"], found = gentle_first(bench, joint, known.pose, axis.middle, axis.travel)

    def motion(share: float) -> Reference:
        return triangles(replace(axis, pace=share * axis.pace), known, *asked).reference

    share, slower = within_drive(motion, found, bench.machine.joints[joint - 1], joint)
    result.warnings += [slower] * bool(slower)
    return replace(axis, pace=share * axis.pace), values


def _recorded(
    bench: Bench, known: Known, axis: Axis, motion: Triangles, values: Mapping[str, Any]
) -> Recording:
    """The motion of a joint."""
    name = f"joint{axis.number}"
    rec = bench.record(
        name, known.program, ["play_time", "q", "tau"], decimation=motion.stride,
        reference=motion.reference, before=_approach(known, motion), **values,
    )
    stood(name, axis.number, bench.seen, bench.machine.joints[axis.number - 1])
    return rec


def _unit(known: Known, number: int) -> str:
    return known.axes[number].unit if number in known.axes else ""


def _approach(known: Known, motion: Triangles) -> float:
    """Time to the first row, s; the shipped arm has its own."""
    if known.program != PROGRAM:
        return 1.0
    return travel_time(known, known.pose, motion.reference.q[0])


def triangles(axis: Axis, known: Known, cycles: int, period: float) -> Triangles:
    """Speed 0, peak, 0, -peak, 0 in straight lines, ``cycles`` + 1 times; and quicker ones, which
    show the load, of a machine that is not the shipped one.
    """
    if not axis.travel > 0.0:
        raise Unmeasured(
            f"joint {axis.number}: its range is {axis.low:g} to {axis.high:g} {axis.unit}: no way"
            " to move"
        )
    unknown = known.program == PROGRAM
    rise = axis.travel / axis.pace
    total = 4.0 * rise * (cycles + 1 + (QUICK / QUICKER if unknown else 0.0))
    stride = stride_of(total, period)
    step = period * stride
    rows = round(rise / step)
    slow, quick = rows * step, max(1, round(rows / QUICKER)) * step
    peaks = [axis.pace] * (cycles + 1) + ([axis.pace * rise / quick] * QUICK if unknown else [])
    rises = np.repeat([slow] * (cycles + 1) + ([quick] * QUICK if unknown else []), 4)
    knots = np.r_[0.0, np.cumsum(rises)].tolist()
    values = [v for peak in peaks for v in (0.0, peak, 0.0, -peak)] + [0.0]
    motion = integrate_velocity(make_grid(knots[-1], step), knots, values)
    q = np.tile(known.pose, (len(motion[0]), 1))
    qd, qdd = np.zeros_like(q), np.zeros_like(q)
    j = axis.number - 1
    q[:, j] = axis.middle - 0.5 * axis.travel + motion[0]
    qd[:, j], qdd[:, j] = motion[1:]
    reference = Reference(q, step, qd, qdd, kind="triangle", machine="")
    return Triangles(reference, 4 * rows, 4 * round(quick / step) if unknown else 0, stride)


def friction_curve(rec: Recording, known: Known, axis: Axis, motion: Triangles) -> Curve:
    """Speed and friction torque (the torque less what inertia and weight take) of one joint over a
    slow cycle, averaged over all but the first; and where the joint loses speed.

    After a reversal bristles bend first; only while it loses speed does the joint surely slide. The
    average is smoothed by a local parabola of 41 ms before it is differentiated.
    """
    rows = playing(rec, motion.reference.samples)
    n = len(known.pose)
    q, tau = (rec[name].reshape(-1, n)[rows] for name in ("q", "tau"))
    dt, period = rec.sample_time, rec.sample_time / rec.decimation
    # what acts at a sample is the mean of the commands of the two samples before it
    t = np.arange(len(q)) * dt
    tau = np.stack([np.interp(t - ACTS * period, t, column) for column in tau.T], axis=1)
    quick = QUICK * motion.quick
    cycles = (motion.reference.samples - quick) // motion.slow
    slow = slice(motion.slow, cycles * motion.slow)
    window = _window(axis, dt)

    def averaged(x: Array) -> Array:
        return np.asarray(x[slow].reshape(cycles - 1, motion.slow, n).mean(axis=0))

    mean_q, mean_tau = averaged(q), averaged(tau)
    qd, qdd = (smoothed(mean_q, window, dt, order, ends="wrap") for order in (1, 2))
    torque = smoothed(mean_tau, window, ends="wrap")
    j = axis.number - 1
    load = axis.load
    model: Load | None = None
    if known.program == PROGRAM:
        begun = cycles * motion.slow + motion.quick
        plan = np.stack([motion.reference.qd[:, j], motion.reference.qdd[:, j]])
        parts = [
            _part(
                q[rows_], tau[rows_, j], plan[:, rows_], dt, (window, cycle // 4), known,
                axis.number,
            )
            for rows_, cycle in (
                (slow, motion.slow),
                (slice(begun, begun + (QUICK - 1) * motion.quick), motion.quick),
            )
        ]
        # another joint that gave way has changed the weight
        away = float(np.ptp(np.delete(mean_q, j, axis=1), axis=0).max(initial=0.0))
        load, model = _moved(parts, known, axis, away)
        known = with_loads(known, {axis.number: load})
    friction = torque[:, j] - known.other(axis.number, mean_q, qd, qdd)
    v = qd[:, j]
    # slower than what one window gains, the smoothing mixes both directions
    mixed = np.abs(v) < 0.5 * window * dt * axis.pace**2 / axis.travel
    slowing = (v * qdd[:, j] < 0) & _after_peak(v, axis.pace) & ~mixed
    order = np.argsort(v)
    return Curve(v[order], friction[order], slowing[order], load, model)


def _moved(
    parts: Sequence[Moved], known: Known, axis: Axis, away: float
) -> tuple[Load, Load | None]:
    """What a joint moves: by the model where there is one and the motion does not contradict it,
    else by the motion; and that of a model which it contradicts. ``away``: what the others moved,
    rad; a model knows what that does.
    """
    if known.rigid is None:
        load = measured_load(parts, axis)
        names = ("weight_std", "cos_std", "sin_std")
        stds = {n: float(np.hypot(getattr(load, n), load.most * away)) for n in names}
        return replace(load, **stds), None
    shown = contradicting(parts, axis)
    return (axis.load, None) if shown is None else (shown, axis.load)


def _after_peak(v: Array, peak: float) -> Mask:
    """Rows of a cycle from a peak of the speed to the next reversal: bristles that bend after it
    swing, and lose speed as well.
    """
    after = np.zeros(len(v), dtype=bool)
    ends = np.flatnonzero(np.diff(np.sign(v)) != 0) + 1
    for first, last in zip(np.r_[0, ends], np.r_[ends, len(v)], strict=True):
        size = np.abs(v[first:last])
        if size.max(initial=0.0) > 0.5 * peak:
            after[first + int(np.argmax(size)) : last] = True
    return after


def _window(axis: Axis, dt: float) -> int:
    """Samples of the local parabola: 41 ms, and more where a coarse encoder would hide whether the
    joint gains or loses speed.

    Of n samples with a standard deviation s the second derivative has s sqrt(720/n^5)/dt^2.
    """
    counts = axis.count / 12**0.5
    wanted = QUIET * axis.pace**2 / axis.travel
    samples = (720.0 * (counts / (wanted * dt**2)) ** 2) ** 0.2
    return int(max(5, 2 * round(0.5 * max(SMOOTH / dt, float(samples))) + 1))


def _part(
    q: Array, tau: Array, plan: Array, dt: float, windows: tuple[int, int], known: Known, joint: int
) -> Moved:
    """Rows of a joint's motion, smoothed, that say what it moves: those in which it is to slide
    surely, and that are not beside a jump of the acceleration. Of the torque it is what a model
    leaves, where there is one.

    Rows are chosen by the plan, since those that noise chooses are not like the others.

    Parameters
    ----------
    plan : ndarray
        Planned speed and acceleration of the joint, one row each.
    windows : tuple of int
        Rows that are smoothed over, and of a rise to the peak.
    """
    window, rise = windows
    every_q, every_qd, every_qdd = (smoothed(q, window, dt, order) for order in range(3))
    j = joint - 1
    wanted, gains = plan
    pace = np.abs(wanted) / np.abs(wanted).max()
    surely = (pace > SURELY) | ((wanted * gains < 0) & (pace > LEAST))
    edge = np.arange(len(q))
    beside = max(0.6 * window, SETTLES / dt) / rise
    rows = surely & (pace < min(PEAK, 1.0 - beside))
    rows &= (edge > window) & (edge < len(q) - window)
    every = np.flatnonzero(rows)[:: max(1, window // 4)]
    torque = smoothed(tau, window)[every]
    if known.rigid is not None:
        torque = torque - known.other(joint, every_q[every], every_qd[every], every_qdd[every])
    stretch = np.cumsum(np.abs(np.diff(rows, prepend=False)))[every]
    return Moved(
        every_q[every, j], every_qd[every, j], every_qdd[every, j], torque, stretch, gains[every]
    )


def _report(result: Result, known: Known, axis: Axis, curve: Curve) -> None:
    """The rows of the table; and of a machine that is not the shipped one the load and the line
    that friction ends in.
    """
    v, f = curve.speed, curve.friction
    for share in AT:
        near = (np.abs(v - share * axis.pace) < NEAR * axis.pace) & curve.slowing
        if near.any():
            result.tables.setdefault("curve", []).append(
                {
                    "joint": axis.number,
                    f"speed {axis.unit}/s": round(share * axis.pace, 6),
                    f"friction {axis.force}": float(f"{f[near].mean():.4g}")
                    if known.program == PROGRAM else round(float(f[near].mean()), 3),
                }
            )  # fmt: skip
    if known.program != PROGRAM:
        return
    j, force, unit, load = axis.number, axis.force, axis.unit, curve.load
    result.values[f"peak{j}"] = Estimate(axis.pace, 0.0, f"{unit}/s")
    if curve.slid(axis).sum() < FEWEST:
        result.warnings.append(
            f"Joint {j}: neither friction nor what it moves is told. Of the {axis.pace:.2g}"
            f" {unit}/s asked for it came to {np.abs(v).max(initial=0.0):.2g}, with a limit of"
            f" {axis.torque:.3g} {force}: look at the recording for what holds it, or let the"
            " machine declare a larger torque_max."
        )
        return
    inertia = "kg m^2" if unit == "rad" else "kg"
    result.values[f"inertia{j}"] = Estimate(load.inertia, load.inertia_std, inertia)
    turns = unit == "rad"
    for name, value, std in (
        ("", load.flat, load.weight_std),
        ("_cos", load.cos, load.cos_std or load.weight_std),
        ("_sin", load.sin, load.sin_std or load.weight_std),
    ):
        if value or (name != "") == turns:
            result.values[f"weight{j}{name}"] = Estimate(value, std, force)
    if turns:
        middle = float(load.weight(np.array(axis.middle)))
        result.values[f"weight{j}_middle"] = Estimate(middle, load.weight_std, force)
    if load.uneven:
        result.values[f"uneven{j}"] = Estimate(load.uneven, load.weight_std, force)
    _report_line(result, axis, curve)
    if curve.model is not None:
        _report_model(result, axis, curve.model, load)
    if known.rigid is None and load.weighs and not load.uneven:
        result.warnings.append(
            f"Joint {j} carries up to {load.most:.3g} {force}. By motion alone that is not told"
            " from a friction that is larger in one direction: both directions are taken to be"
            " alike. A model (--model) tells them apart."
        )
    if known.rigid is None and load.inertia < 2.0 * load.inertia_std:
        result.warnings.append(
            f"Joint {j}: its inertia, {result.values[f'inertia{j}']}, is not told from zero."
        )


def _report_line(result: Result, axis: Axis, curve: Curve) -> None:
    """The line that friction ends in, where it is no drive."""
    j, force = axis.number, axis.force
    (level, slope), (of_level, of_slope) = _line(curve, axis)
    if level < -NORMAL * of_level:
        result.warnings.append(
            f"Joint {j}: its friction is not told. It came out as"
            f" {Estimate(level, of_level, force)}, and none is below zero: inertia and weight are"
            " wrong by more than friction is. Look at the model, or at the recording."
        )
        return
    result.values[f"level{j}"] = Estimate(max(0.0, level), of_level, force)
    result.values[f"slope{j}"] = Estimate(slope, of_slope, f"{force} s/{axis.unit}")


def _line(curve: Curve, axis: Axis) -> tuple[Array, Array]:
    """Level and slope of the line that friction ends in, and their standard deviations.

    Neighbouring points share their smoothing, so means over twentieths of the speed count as one
    measurement each, of each direction. Neighbouring means still share a little, and what varies
    slowly: the deviations are the larger of those for independent means and for pairs that are
    alike. (By the former alone 58 of 66 intervals of the level of a slow joint held; now 41 of
    44.) The line begins with all of them, and leaves out the
    slowest as long as it surely lies off the rest: near rest bristles, creep or a fall with speed
    are no line. Those of the upper half stay. (To begin with the upper half and to end at the first
    that lies off ends where the line itself is off: of copies that differ by noise alone 87 % of
    the intervals held.)
    """
    rows = curve.slid(axis)
    v, up = np.abs(curve.speed[rows]), np.sign(curve.speed[rows])
    torque = up * curve.friction[rows]
    part = np.minimum((v / axis.pace * PARTS).astype(int), PARTS - 1)
    keys = [(k, s) for k in range(PARTS) for s in (1, -1) if ((part == k) & (up == s)).any()]
    here = [(part == k) & (up == s) for k, s in keys]
    means = np.array([(v[x].mean(), torque[x].mean()) for x in here]).T
    of_part, sense = np.array(keys).T
    A = np.stack([np.ones(len(keys)), means[0], sense], axis=1)
    least = PARTS // 2
    first = next(k for k in range(least + 1) if k == least or _joins(A, means[1], of_part, k))
    used = of_part >= first
    A, size, pairs = A[used], means[1][used], 2 * (of_part[used] // 2) + (sense[used] > 0)
    x, _, inverse = least_squares(A, size)
    free = len(np.unique(pairs)) - A.shape[1]
    alike = [(pairs, free)] if free > 0 else []
    half = widest(A, size - A @ x, inverse, np.eye(A.shape[1]), alike)
    load = curve.load
    return x[:2], np.hypot(half[:2] / NORMAL, [load.level_std, load.slope_std])


def _joins(A: Array, size: Array, of_part: Array, k: int) -> bool:
    """Whether twentieth k of the speed lies on the line of those above it, and all from there on on
    that of the upper half, as far as chance explains.
    """
    from scipy.special import fdtri, stdtrit

    new, above, every = of_part == k, of_part > k, of_part >= k
    upper = of_part >= PARTS // 2
    beside = int(upper.sum()) - 3
    if not new.any() or beside < 1:
        return False
    x, _, inverse = least_squares(A[above], size[above])
    left, free = size[above] - A[above] @ x, int(above.sum()) - 3
    mean = A[new].mean(axis=0)
    spread = float(left @ left) / free * (1.0 / int(new.sum()) + mean @ inverse @ mean)
    off = float(size[new].mean() - mean @ x)
    if abs(off) > float(stdtrit(free, 0.5 + 0.5 * NO_CHANCE)) * spread**0.5:
        return False
    squares = [float(np.sum((size[p] - A[p] @ least_squares(A[p], size[p])[0]) ** 2))
               for p in (every, upper)]  # fmt: skip
    more = int(every.sum() - upper.sum())
    most = fdtri(more, beside, NO_CHANCE) * more * squares[1] / beside
    return bool(squares[0] - squares[1] <= most)


def _report_model(result: Result, axis: Axis, model: Load, load: Load) -> None:
    """What a model says that the motion contradicts."""
    j, force = axis.number, axis.force
    inertia = "kg m^2" if axis.unit == "rad" else "kg"
    result.values[f"model_inertia{j}"] = Estimate(model.inertia, 0.0, inertia)
    result.values[f"model_weight{j}"] = Estimate(model.most, 0.0, force)
    moved = Estimate(load.inertia, load.inertia_std, inertia)
    weight = Estimate(load.most, load.weight_std, force)
    result.warnings.append(
        f"Joint {j}: the model contradicts the motion. It says an inertia of {model.inertia:.4g}"
        f" {inertia} and a weight of up to {model.most:.4g} {force}; the motion shows {moved} and"
        f" {weight}. Friction is what is left beside those of the motion: correct the model."
    )


def _draw(curves: Mapping[int, tuple[Axis, Curve]], cycles: int, bench: Bench) -> str:
    columns = min(3, len(curves))
    figure, axes = make_figure(-(-len(curves) // columns), columns, width=max(4.5 * columns, 6.0))
    for panel, (axis, curve) in zip(axes.flat, curves.values(), strict=False):
        v, f, slowing = curve.speed, curve.friction, curve.slowing
        panel.plot(
            v[~slowing], f[~slowing], ".", color=AMBER, markersize=1.5, label="gaining speed"
        )
        panel.plot(
            v[slowing], f[slowing], ".", color=BLUE, markersize=1.5, label="losing speed: sliding"
        )
        what = "torque" if axis.unit == "rad" else "force"
        label(
            panel, f"speed ({axis.unit}/s)", f"friction {what} ({axis.force})",
            f"joint {axis.number}: mean of {cycles} triangles", legend=True,
        )  # fmt: skip
    for panel in axes.flat[len(curves) :]:
        panel.set_visible(False)
    return save(figure, bench.folder / "low_speed.png")
