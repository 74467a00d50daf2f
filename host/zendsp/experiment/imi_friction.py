"""Friction of the planar arm, measured three ways: by breaking away, at constant torque, and at low
speed.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError
from zendsp.experiment.figures import AMBER, BLUE, GREY, RED, label, make_figure, save
from zendsp.experiment.lab import Bench, Lab, own_program, playing
from zendsp.experiment.result import Estimate, Result
from zendsp.recording import Recording
from zendsp.reference import load_machine, make_triangle

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

MACHINE = "imi_planar"
JOINTS = (1, 2)
KP, KD = [2000.0, 300.0], [120.0, 12.0]  # N m/rad, N m s/rad: hold the other joint
BRAKE = [30.0, 5.0]  # N m s/rad
# N m, height of a torque step; ten times as high, they shake the joint and its bristles creep
STEP = {1: 0.005, 2: 0.002}
# s, its length: the torque grows slowly, so that little of it is added while the joint runs away
HOLD = 0.01
P1, P2, P3 = 3.473, 0.196, 0.242  # kg m^2, of the arm's published model
DELAY = 1  # samples from a command to its effect


def _padded(values: list[float]) -> list[float]:
    return [*values, *([0.0] * (8 - len(values)))]


def inertia_torque(q: Array, qd: Array, qdd: Array) -> Array:
    """M(q) qdd + C(q, qd) of the published model, N m; arrays (N, 2)."""
    c, s = P3 * np.cos(q[:, 1]), P3 * np.sin(q[:, 1])
    first = (
        (P1 + 2 * c) * qdd[:, 0] + (P2 + c) * qdd[:, 1] - s * qd[:, 1] * (2 * qd[:, 0] + qd[:, 1])
    )
    second = (P2 + c) * qdd[:, 0] + P2 * qdd[:, 1] + s * qd[:, 0] ** 2
    return np.stack([first, second], axis=1)


def static(lab: Lab, positions: tuple[float, ...] = (-1.2, -0.4, 0.4, 1.2)) -> Result:
    """Static friction: torque steps CW and CCW from several positions; the mean of the torques at
    which a joint breaks away.
    """
    result = Result("imi-static", "Static friction of the planar arm", MACHINE)
    found: dict[tuple[int, int], list[float]] = {}
    bristles: dict[int, list[float]] = {1: [], 2: []}
    with lab.bench(MACHINE, result.name) as bench:
        for joint in JOINTS:
            for direction in (1, -1):
                pairs = [_break_away(bench, joint, direction, x) for x in positions]
                found[joint, direction] = [torque for torque, _ in pairs]
                bristles[joint] += [stiffness for _, stiffness in pairs]
        result.recordings, result.target = bench.recordings, bench.where
        rows = []
        for (joint, direction), torques in found.items():
            mean, std = float(np.mean(torques)), float(
                np.std(torques, ddof=1) / np.sqrt(len(torques))
            )
            std = float(np.hypot(std, STEP[joint] / np.sqrt(12 * len(torques))))
            result.values[f"breakaway{joint}_{'ccw' if direction > 0 else 'cw'}"] = Estimate(
                mean, std, "N m"
            )
            rows.append(
                {
                    "joint": joint,
                    "direction": "ccw" if direction > 0 else "cw",
                    "torque N m": round(mean, 3),
                    "± N m": round(std, 3),
                    "each N m": ", ".join(f"{x:.2f}" for x in torques),
                }
            )
        result.tables["breakaway"] = rows
        for joint in JOINTS:
            both = [result.values[f"breakaway{joint}_{d}"] for d in ("ccw", "cw")]
            result.values[f"breakaway{joint}"] = Estimate(
                float(np.mean([e.value for e in both])),
                float(np.hypot(both[0].std, both[1].std) / 2),
                "N m",
            )
            mean, count = float(np.mean(bristles[joint])), len(bristles[joint])
            result.values[f"stiffness{joint}"] = Estimate(
                mean, float(np.std(bristles[joint], ddof=1) / np.sqrt(count)), "N m/rad"
            )
        result.figure = _draw_static(found, positions, bench)
    return result


def _break_away(bench: Bench, joint: int, direction: int, position: float) -> tuple[float, float]:
    enough = {1: 14.0, 2: 4.2}[joint]  # N m
    start = [0.0, 0.0]
    start[joint - 1] = position
    rec = bench.record(
        f"joint{joint}_{'ccw' if direction > 0 else 'cw'}_{position:+.1f}",
        own_program("push.c"),
        ["q", "torque", "phase"],
        seconds=3.5 + enough / STEP[joint] * HOLD,
        joint=joint,
        direction=direction,
        place=_padded(start),
        Kp=_padded(KP),
        Kd=_padded(KD),
        brake=_padded(BRAKE),
        increment=STEP[joint],
        hold=HOLD,
        threshold=0.05,
    )
    torque = breakaway_torque(rec, joint)
    return torque, bristle_stiffness(rec, joint, torque)


def breakaway_torque(rec: Recording, joint: int, speed: float = 0.05, window: int = 20) -> float:
    """Torque at which a joint ran away: the first whose speed, over ``window`` samples, exceeds
    ``speed`` rad/s.

    Before that it creeps: bristles bend by more than the torque over their stiffness as the level
    is approached.
    """
    pushed = np.flatnonzero(rec["phase"] >= 2)
    q = rec["q"][pushed, joint - 1]
    rate = np.abs(q[window:] - q[:-window]) / (window * rec.sample_time)
    away = np.flatnonzero(rate > speed)
    if len(away) == 0:
        most = abs(rec["torque"][pushed]).max()
        raise RecordingError(
            f"joint {joint} did not break away: {most:.3g} N m were not enough; look at the"
            " recording"
        )
    return float(abs(rec["torque"][pushed[away[0] + window // 2]]))


def bristle_stiffness(rec: Recording, joint: int, level: float) -> float:
    """Stiffness of the spring that friction is before it slides, N m/rad, from the way under up to
    30 % of the breakaway torque.

    A bristle creeps as it nears its level: q = -(level / stiffness) ln(1 - torque / level) (Dahl
    1968, quasi-static).
    """
    pushed = np.flatnonzero(rec["phase"] == 2)
    torque, q = np.abs(rec["torque"][pushed]), np.abs(
        rec["q"][pushed, joint - 1] - rec["q"][pushed[0], joint - 1]
    )
    used = (torque > 0.05 * level) & (torque < 0.3 * level)
    bend = -level * np.log(1 - torque[used] / level)
    slope = float(np.polyfit(bend, q[used], 1)[0])
    return 1.0 / slope if slope > 0 else float("nan")


def _draw_static(
    found: dict[tuple[int, int], list[float]], positions: tuple[float, ...], bench: Bench
) -> str:
    figure, axes = make_figure(1, 2)
    for axis, joint in zip(axes[0], JOINTS, strict=True):
        for direction, colour, word in ((1, BLUE, "counterclockwise"), (-1, RED, "clockwise")):
            torques = found[joint, direction]
            axis.plot(positions, torques, "o", color=colour, label=word, markersize=6)
            axis.axhline(float(np.mean(torques)), color=colour, linewidth=0.8, linestyle="--")
        low, high = axis.get_ylim()
        axis.set_ylim(low - 0.25 * (high - low), high + 0.5 * (high - low))
        label(axis, "start position (rad)", "breakaway torque (N m)", f"joint {joint}", legend=True)
    return save(figure, bench.folder / "static.png")


def viscous(lab: Lab, speeds: tuple[float, ...] = (2.0, 2.5, 3.0, 4.0, 5.0)) -> Result:
    """Friction at high speed: a constant torque, open loop, until the speed is steady."""
    result = Result("imi-viscous", "Friction of the planar arm at high speed", MACHINE)
    points: dict[int, list[tuple[float, float, float]]] = {1: [], 2: []}
    # N m, N m s/rad: only to choose torques that give about these speeds
    guess = {1: (8.45, 5.3), 2: (2.35, 1.1)}
    with lab.bench(MACHINE, result.name) as bench:
        for joint in JOINTS:
            for direction in (1, -1):
                for speed in speeds:
                    torque = guess[joint][0] + guess[joint][1] * speed
                    points[joint].append(_steady(bench, joint, direction, torque))
        result.recordings, result.target = bench.recordings, bench.where
        for joint in JOINTS:
            for direction, word in ((1, "ccw"), (-1, "cw")):
                chosen = np.array([p[:2] for p in points[joint] if np.sign(p[0]) == direction])
                (slope, level), covariance = np.polyfit(
                    np.abs(chosen[:, 0]), np.abs(chosen[:, 1]), 1, cov=True
                )
                result.values[f"viscous{joint}_{word}"] = Estimate(
                    float(slope), float(np.sqrt(covariance[0, 0])), "N m s/rad"
                )
                result.values[f"level{joint}_{word}"] = Estimate(
                    float(level), float(np.sqrt(covariance[1, 1])), "N m"
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


def _steady(bench: Bench, joint: int, direction: int, torque: float) -> tuple[float, float, float]:
    """Mean speed, friction torque and acceleration on the last rad before the joint is braked."""
    start = [0.0, 0.0]
    start[joint - 1] = -1.9 * direction
    rec = bench.record(
        f"joint{joint}_{direction * torque:+.1f}Nm",
        own_program("push.c"),
        ["q", "tau", "phase"],
        seconds=8.0,
        joint=joint,
        direction=direction,
        place=_padded(start),
        Kp=_padded(KP),
        Kd=_padded(KD),
        brake=_padded(BRAKE),
        first=torque,
        lower=-1.6,
        upper=1.6,
    )
    q = rec["q"][:, joint - 1]
    rows = np.flatnonzero((rec["phase"] == 2) & (np.abs(q) < 1.55) & (q * direction > 0.4))
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
                x,
                line,
                color=GREY,
                linewidth=1.0,
                linestyle="--",
                label="line" if direction > 0 else None,
            )
        label(axis, "speed (rad/s)", "friction torque (N m)", f"joint {joint}", legend=True)
    return save(figure, bench.folder / "viscous.png")


def low_speed(lab: Lab, cycles: int = 6, rise: float = 1.0) -> Result:
    """Friction at low speed: inverse dynamics with PD along triangular velocity, 0 to 1 rad/s and
    back, repeated, averaged.
    """
    result = Result("imi-low-speed", "Friction of the planar arm at low speed", MACHINE)
    machine = load_machine(MACHINE)
    curves: dict[int, tuple[Array, Array, Mask]] = {}
    with lab.bench(MACHINE, result.name) as bench:
        for joint in JOINTS:
            reference = make_triangle(
                machine, joint=joint, start=[0.0, 0.0], peak=1.0, rise=rise, cycles=cycles + 1
            )
            rec = bench.record(
                f"joint{joint}",
                "inverse_dynamics.c",
                ["play_time", "q", "tau"],
                reference=reference,
            )
            curves[joint] = friction_curve(
                rec, joint, reference.samples, round(4 * rise / reference.sample_time)
            )
        result.recordings, result.target = bench.recordings, bench.where
        rows = []
        for joint, (v, f, slowing) in curves.items():
            for at in (-0.9, -0.5, -0.2, -0.1, 0.1, 0.2, 0.5, 0.9):
                near = (np.abs(v - at) < 0.02) & slowing
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
                v[slowing],
                f[slowing],
                ".",
                color=BLUE,
                markersize=1.5,
                label="losing speed: sliding",
            )
            label(
                axis,
                "speed (rad/s)",
                "friction torque (N m)",
                f"joint {joint}: mean of {cycles} triangles",
                legend=True,
            )
        result.figure = save(figure, bench.folder / "low_speed.png")
    return result


def friction_curve(
    rec: Recording, joint: int, samples: int, period: int
) -> tuple[Array, Array, Mask]:
    """Speed and friction torque of one joint over one period, averaged over all but the first: tau
    - M qdd - C.

    Also, where the joint loses speed: after a reversal bristles bend first, so only then does it
    surely slide. The average over repetitions is smoothed by a local parabola of 41 ms before it is
    differentiated.
    """
    from scipy.signal import savgol_filter

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
    qd, qdd = (
        np.asarray(savgol_filter(q, 41, 2, deriv=order, delta=dt, axis=0, mode="wrap"))
        for order in (1, 2)
    )
    tau = np.asarray(savgol_filter(tau, 41, 2, axis=0, mode="wrap"))
    friction = tau - inertia_torque(q, qd, qdd)
    v = qd[:, joint - 1]
    order = np.argsort(v)
    return v[order], friction[order, joint - 1], (v * qdd[:, joint - 1] < 0)[order]
