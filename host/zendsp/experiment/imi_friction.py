"""Sliding friction of the planar arm: at constant torque, and at low speed."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.experiment.estimates import NORMAL, line_fit, smoothed
from zendsp.experiment.figures import AMBER, BLUE, GREY, label, make_figure, save
from zendsp.experiment.lab import Bench, Lab, playing, push_program
from zendsp.experiment.result import Estimate, Result, Row
from zendsp.recording import Recording
from zendsp.reference import load_machine, make_triangle

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MACHINE = "imi_planar"
JOINTS = (1, 2)
KP, KD = [2000.0, 300.0], [120.0, 12.0]  # N m/rad, N m s/rad: hold the other joint
BRAKE = [30.0, 5.0]  # N m s/rad
NEAR = 0.02  # rad/s: speeds of the curve that one row of its table is the mean of
P1, P2, P3 = 3.473, 0.196, 0.242  # kg m^2, of the arm's published model
DELAY = 1  # samples from a command to its effect


def padded(values: list[float]) -> list[float]:
    """The values, filled up to the length of the program's arrays."""
    return [*values, *([0.0] * (8 - len(values)))]


def inertia_torque(q: Array, qd: Array, qdd: Array) -> Array:
    """M(q) qdd + C(q, qd) of the published model, N m; arrays (N, 2)."""
    c, s = P3 * np.cos(q[:, 1]), P3 * np.sin(q[:, 1])
    first = (
        (P1 + 2 * c) * qdd[:, 0] + (P2 + c) * qdd[:, 1] - s * qd[:, 1] * (2 * qd[:, 0] + qd[:, 1])
    )
    second = (P2 + c) * qdd[:, 0] + P2 * qdd[:, 1] + s * qd[:, 0] ** 2
    return np.stack([first, second], axis=1)


def viscous(lab: Lab, speeds: tuple[float, ...] = (2.0, 2.5, 3.0, 4.0, 5.0)) -> Result:
    """Friction at high speed: a constant torque, open loop, until the speed is steady."""
    result = Result("high-speed", "Friction of the planar arm at high speed", MACHINE)
    points: dict[int, list[tuple[float, float, float]]] = {1: [], 2: []}
    # N m, N m s/rad: only to choose torques that give about these speeds
    guess = {1: (8.45, 5.3), 2: (2.35, 1.1)}
    with lab.bench(result.name) as bench:
        for joint in JOINTS:
            for direction in (1, -1):
                for speed in speeds:
                    torque = guess[joint][0] + guess[joint][1] * speed
                    # friction varies with place: parts of the way that differ make that visible
                    part = (lab.random.uniform(0.1, 0.5), lab.random.uniform(1.15, 1.55))
                    points[joint].append(_steady(bench, joint, direction, torque, part))
        result.recordings, result.target = bench.recordings, bench.where
        for joint in JOINTS:
            for direction, word in ((1, "ccw"), (-1, "cw")):
                chosen = np.array([p[:2] for p in points[joint] if np.sign(p[0]) == direction])
                (level, slope), half, _ = line_fit(chosen[:, 0], chosen[:, 1])
                result.values[f"viscous{joint}_{word}"] = Estimate(
                    float(slope), float(half[1] / NORMAL), "N m s/rad"
                )
                result.values[f"level{joint}_{word}"] = Estimate(
                    float(level), float(half[0] / NORMAL), "N m"
                )
        result.tables["points"] = [
            {
                "joint": j,
                "speed rad/s": round(v, 4),
                "friction N m": round(f, 4),
                "acceleration rad/s^2": round(a, 3),
            }
            for j in JOINTS
            for v, f, a in points[j]
        ]
        late = max(abs(p[2]) for p in points[1])
        result.warnings.append(
            "Joint 1 crosses its range of 4 rad before its transient of 0.75 s has quite ended: up"
            f" to {late:.2g} rad/s² are left, and their inertia torque is subtracted. The paper"
            " waits for the end of the transient."
        )
        result.figure = _draw_viscous(points, result, bench)
    return result


def _steady(
    bench: Bench, joint: int, direction: int, torque: float, part: tuple[float, float]
) -> tuple[float, float, float]:
    """Mean speed, friction torque and acceleration over a part of the way (rad)."""
    start = [0.0, 0.0]
    start[joint - 1] = -1.9 * direction
    rec = bench.record(
        f"joint{joint}_{direction * torque:+.1f}Nm", push_program(), ["q", "tau", "phase"],
        seconds=8.0, joint=joint, direction=direction, place=padded(start), Kp=padded(KP),
        Kd=padded(KD), brake=padded(BRAKE), first=torque, lower=-1.6, upper=1.6,
    )
    q = rec["q"][:, joint - 1]
    way = q * direction
    rows = np.flatnonzero((rec["phase"] == 2) & (way < part[1]) & (way > part[0]))
    t = rec.t[rows] - rec.t[rows].mean()
    quadratic, slope, _ = np.polyfit(t, q[rows], 2)
    v, a = np.zeros((1, 2)), np.zeros((1, 2))
    v[0, joint - 1], a[0, joint - 1] = slope, 2 * quadratic
    middle = rec["q"][rows].mean(axis=0)[None, :]
    friction = rec["tau"][rows, joint - 1].mean() - inertia_torque(middle, v, a)[0, joint - 1]
    return float(slope), float(friction), float(2 * quadratic)


def _draw_viscous(
    points: dict[int, list[tuple[float, float, float]]], result: Result, bench: Bench
) -> str:
    figure, axes = make_figure(1, 2)
    for axis, joint in zip(axes[0], JOINTS, strict=True):
        v, f, _ = np.array(points[joint]).T
        axis.plot(v, f, "o", color=BLUE, markersize=5, label="measured")
        for direction, word in ((1, "ccw"), (-1, "cw")):
            x = np.array([0.0, direction * np.abs(v).max()])
            line = direction * (
                result.values[f"level{joint}_{word}"].value
                + result.values[f"viscous{joint}_{word}"].value * np.abs(x)
            )
            axis.plot(
                x, line, color=GREY, linewidth=1.0, linestyle="--",
                label="line" if direction > 0 else None,
            )
        label(axis, "speed (rad/s)", "friction torque (N m)", f"joint {joint}", legend=True)
    return save(figure, bench.folder / "viscous.png")


def low_speed(lab: Lab, cycles: int = 6, rise: float = 1.0) -> Result:
    """Friction at low speed: inverse dynamics with PD along a triangular velocity, 0 to 1 rad/s and
    back, repeated and averaged.
    """
    result = Result("low-speed", "Friction of the planar arm at low speed", MACHINE)
    machine = load_machine(MACHINE)
    curves: dict[int, tuple[Array, Array, Mask]] = {}
    with lab.bench(result.name) as bench:
        for joint in JOINTS:
            reference = make_triangle(
                machine, joint=joint, start=[0.0, 0.0], peak=1.0, rise=rise, cycles=cycles + 1
            )
            rec = bench.record(
                f"joint{joint}", "inverse_dynamics.c", ["play_time", "q", "tau"],
                reference=reference,
            )
            curves[joint] = friction_curve(
                rec, joint, reference.samples, round(4 * rise / reference.sample_time)
            )
        result.recordings, result.target = bench.recordings, bench.where
        rows: list[Row] = []
        for joint, (v, f, slowing) in curves.items():
            for at in (-0.9, -0.5, -0.2, -0.1, 0.1, 0.2, 0.5, 0.9):
                near = (np.abs(v - at) < NEAR) & slowing
                rows.append(
                    {
                        "joint": joint,
                        "speed rad/s": at,
                        "friction N m": round(float(f[near].mean()), 3),
                    }
                )
        result.tables["curve"] = rows
        for joint, (v, f, slowing) in curves.items():
            np.savez(bench.folder / f"curve{joint}.npz", speed=v, friction=f, slowing=slowing)
        figure, axes = make_figure(1, 2)
        for axis, joint in zip(axes[0], JOINTS, strict=True):
            v, f, slowing = curves[joint]
            axis.plot(
                v[~slowing], f[~slowing], ".", color=AMBER, markersize=1.5, label="gaining speed"
            )
            axis.plot(
                v[slowing], f[slowing], ".", color=BLUE, markersize=1.5,
                label="losing speed: sliding",
            )
            label(
                axis, "speed (rad/s)", "friction torque (N m)",
                f"joint {joint}: mean of {cycles} triangles", legend=True,
            )
        result.figure = save(figure, bench.folder / "low_speed.png")
    return result


def friction_curve(
    rec: Recording, joint: int, samples: int, period: int
) -> tuple[Array, Array, Mask]:
    """Speed and friction torque (tau - M qdd - C) of one joint over a period, averaged over all
    periods but the first; and where the joint loses speed.

    After a reversal bristles bend first; only while it loses speed does the joint surely slide. The
    average is smoothed by a local parabola of 41 ms before it is differentiated.
    """
    rows = playing(rec, samples)
    q, tau = rec["q"][rows], rec["tau"][rows]
    # what acts at a sample is the command of the sample before
    tau = np.vstack([tau[:1].repeat(DELAY, axis=0), tau[:-DELAY]])
    # and the force at a sample is the mean of the two periods beside it
    tau[1:] = 0.5 * (tau[1:] + tau[:-1])
    cycles = len(q) // period
    q, tau = (
        x[period : cycles * period].reshape(cycles - 1, period, 2).mean(axis=0) for x in (q, tau)
    )
    dt = rec.sample_time * rec.decimation
    qd, qdd = (smoothed(q, 41, dt, order, ends="wrap") for order in (1, 2))
    tau = smoothed(tau, 41, ends="wrap")
    friction = tau - inertia_torque(q, qd, qdd)
    v = qd[:, joint - 1]
    order = np.argsort(v)
    return v[order], friction[order, joint - 1], (v * qdd[:, joint - 1] < 0)[order]
