"""Friction of a joint as one curve: two polynomials of speed, joined, through the results of three
experiments.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import Refused
from zendsp.experiment.breakaway import breakaway
from zendsp.experiment.figures import AMBER, BLUE, GREY, RED, label, make_figure, save
from zendsp.experiment.high_speed import high_speed
from zendsp.experiment.knowing import shipped, weight_of
from zendsp.experiment.lab import Lab, needed
from zendsp.experiment.low_speed import low_speed
from zendsp.experiment.names import result_file
from zendsp.experiment.result import Estimate, FoundEffect, Result, number

Array = npt.NDArray[np.float64]

SPLITS = np.arange(0.15, 0.81, 0.05)  # of the peak of the low speeds
SLOWEST = 0.03  # of the same: below it the smoothing mixes both directions
PEAK = 0.95  # of the largest speed: faster is where the acceleration jumps


@dataclass(frozen=True)
class Curve:
    """Friction of one joint: level_pos, level_neg, then slope, curve, cubic and high_curve of the
    friction block, split, residual.
    """

    coefficients: Array
    std: Array
    split: float
    rms: float

    def size(self, speed: Array) -> Array:
        """|friction| at signed speeds, N m."""
        return np.asarray(_basis(speed, self.split) @ self.coefficients)

    def low(self) -> list[float]:
        """Mean of both directions below the split: c0 … c3 of |v|."""
        p = self.coefficients
        return [float(0.5 * (p[0] + p[1])), float(p[2]), float(p[3]), float(p[4] / self.split)]

    def high(self) -> list[float]:
        """Mean of both directions above the split: c0 … c2 of |v|."""
        p, s = self.coefficients, self.split
        edge = 0.5 * (p[0] + p[1]) + s * (p[2] + s * (p[3] + p[4]))
        slope, curve = p[2] + s * (2 * p[3] + 3 * p[4]), p[5]
        return [float(edge - slope * s + curve * s * s), float(slope - 2 * curve * s), float(curve)]


def _basis(speed: Array, split: float) -> Array:
    """Columns: level of each direction, slope, curve, cubic, high curve; value and slope are
    continuous at the split.
    """
    v = np.abs(speed)
    w = np.maximum(v - split, 0.0)
    low = np.minimum(v, split)
    columns = [
        speed >= 0, speed < 0, v, low**2 + 2 * split * w, low**3 / split + 3 * split * w, w**2,
    ]
    return np.stack([np.asarray(c, dtype=np.float64) for c in columns], axis=1)


def fit_curve(
    speed: Array, friction: Array, weight: Array, peak: float = 1.0, even: bool = False
) -> Curve:
    """Least-squares fit of the joined polynomials; of the ``SPLITS`` the one with the smallest
    residual.

    Parameters
    ----------
    speed, friction : ndarray, shape (N,)
        rad/s and N m, signed.
    weight : ndarray, shape (N,)
        Of each point.
    peak : float
        Of the low speeds, rad/s: that the ``SPLITS`` are parts of.
    even : bool
        Whether both directions have one level.
    """
    best: Curve | None = None
    root = np.sqrt(weight)
    one = np.eye(6)
    one[:2, :2] = 0.5 if even else one[:2, :2]
    for split in SPLITS * peak:
        A = _basis(speed, float(split)) @ one
        b = np.abs(friction)
        solution = np.linalg.lstsq(A * root[:, None], b * root, rcond=None)[0]
        residual = b - A @ solution
        rms = float(np.sqrt(np.average(residual**2, weights=weight)))
        # neighbouring points share their smoothing (41 samples): so many fewer are independent
        variance = (
            rms**2
            * np.linalg.pinv((A * weight[:, None]).T @ A)
            * weight.sum()
            / (max(1.0, len(b) / 41))
        )
        if best is None or rms < best.rms:
            best = Curve(solution, np.sqrt(np.diag(variance)), float(split), rms)
    assert best is not None
    return best


@dataclass(frozen=True)
class Measured:
    """What the three experiments found of one joint.

    Attributes
    ----------
    joint : int
    unit, force : str
    speed, friction, slowing : ndarray
        Of the low-speed experiment.
    fast : ndarray, shape (N, 2)
        Speed and friction of the pushes at constant torque.
    peak : float
        Of the low speeds.
    inertia : float
    even : bool
        Whether both directions count as alike: the joint carries a weight that no model states.
    stiffness : float
        Of the bristles; 0: not told.
    rest : tuple of float
        Breakaway in positive and in negative direction; empty: not measured.
    """

    joint: int
    unit: str
    force: str
    speed: Array
    friction: Array
    slowing: npt.NDArray[np.bool_]
    fast: Array
    peak: float
    inertia: float
    even: bool
    stiffness: float
    rest: tuple[float, ...]

    def curve(self) -> Curve:
        """The joined polynomials through all of it."""
        v, f = self.speed, self.friction
        # at the peaks the acceleration jumps, which the smoothing smears: they are left out
        sliding = (
            (np.abs(v) > SLOWEST * self.peak)
            & (np.abs(v) < PEAK * np.abs(v).max())
            & self.slowing
        )
        fast = self.fast
        speed, friction = np.r_[v[sliding], fast[:, 0]], np.r_[f[sliding], fast[:, 1]]
        weight = np.r_[
            np.full(sliding.sum(), 1.0), np.full(len(fast), sliding.sum() / len(fast) / 3.0)
        ]
        return fit_curve(speed, friction, weight, self.peak, self.even)


def friction_curve(lab: Lab, joints: tuple[int, ...] = ()) -> Result:
    """One friction curve for each joint, from the breakaway, low-speed and high-speed experiments;
    those that are missing are made first.

    Parameters
    ----------
    lab : Lab
    joints : tuple of int
        Which; default: all that were measured at low and at high speed.
    """
    low = needed(lab, "low-speed", lambda lab: low_speed(lab, joints=joints))
    static = needed(lab, "breakaway", lambda lab: breakaway(lab, joints=joints))
    fast = needed(lab, "high-speed", lambda lab: high_speed(lab, joints=joints))
    of = " of the planar arm" if shipped(lab) is not None else ""
    result = Result("friction-curve", f"Friction curve{of}", low.machine, target=low.target)
    folder = lab.folder / result.name
    folder.mkdir(parents=True, exist_ok=True)
    curves: dict[int, tuple[Measured, Curve]] = {}
    for joint in joints or dict.fromkeys(int(number(r, "joint")) for r in low.tables["curve"]):
        if not any(row["joint"] == joint for row in fast.tables["points"]):
            result.warnings.append(
                f"Joint {joint} is left out: at high speed it was not measured; the result of"
                " high-speed says why."
            )
            continue
        measured = _measured(lab, joint, (low, static, fast))
        curves[joint] = measured, measured.curve()
        _report(result, *curves[joint])
    if not curves:
        raise Refused(f"{result.name}: no joint has a curve. " + " ".join(result.warnings))
    result.figure = _draw(curves, folder)
    result.recordings = [
        f"../{r.name}/{name}" for r in (static, low, fast) for name in r.recordings
    ]
    return result


def _measured(lab: Lab, joint: int, results: tuple[Result, Result, Result]) -> Measured:
    low, static, fast = results
    rows = [row for row in fast.tables["points"] if row["joint"] == joint]
    unit = "m" if "speed m/s" in rows[0] else "rad"
    force = "N m" if unit == "rad" else "N"
    arm = shipped(lab)
    if arm is not None:
        peak, inertia, even = arm.axes[joint].pace, arm.axes[joint].load.inertia, False
    else:
        peak, inertia = (low.values[f"{name}{joint}"].value for name in ("peak", "inertia"))
        weighs = any(w.value and w.std for w in weight_of(low, joint))
        even = weighs and f"uneven{joint}" not in low.values
    with np.load(result_file(lab.folder, low.name).parent / f"curve{joint}.npz") as stored:
        curve = {name: stored[name] for name in ("speed", "friction", "slowing")}
    points = np.array(
        [(number(p, f"speed {unit}/s"), number(p, f"friction {force}")) for p in rows]
    )
    words = ("ccw", "cw") if unit == "rad" else ("pos", "neg")
    names = [f"breakaway{joint}_{word}" for word in words]
    if names[0] not in static.values:
        names = [f"breakaway{joint}"] * 2
    rest = tuple(static.values[name].value for name in names if name in static.values)
    told = static.values.get(f"stiffness{joint}", Estimate(0.0))
    return Measured(
        joint, unit, force, fast=points, peak=peak, inertia=inertia, even=even,
        stiffness=told.value, rest=rest, **curve,
    )  # fmt: skip


def _report(result: Result, measured: Measured, curve: Curve) -> None:
    names = ("level_pos", "level_neg", "slope", "curve", "cubic", "high_curve")
    joint, force, s = measured.joint, measured.force, f"s/{measured.unit}"
    square = f"{force} s^2/{measured.unit}^2"
    units = (force, force, f"{force} {s}", square, square, square)
    p = curve.coefficients
    for name, unit, value, std in zip(names, units, p, curve.std, strict=True):
        result.values[f"joint{joint}_{name}"] = Estimate(float(value), float(std), unit)
    result.values[f"joint{joint}_split"] = Estimate(curve.split, 0.0, f"{measured.unit}/s")
    result.values[f"joint{joint}_rms"] = Estimate(curve.rms, 0.0, force)
    result.tables.setdefault("program", []).append(
        {
            "joint": joint,
            "low": [round(x, 6) for x in curve.low()],
            "high": [round(x, 6) for x in curve.high()],
            "split": curve.split,
        }
    )
    base = float(min(p[0], p[1]))
    rest = zip(("slope", "curve", "cubic", "high_curve"), p[2:], strict=True)
    block = {name: Estimate(float(value)) for name, value in rest}
    block |= {"level": Estimate(base, float(curve.std[0]), force), "split": Estimate(curve.split)}
    result.effects.append(FoundEffect("friction_block", joint, block))
    if not measured.even:
        uneven = {
            "level_pos": Estimate(float(p[0] - base)), "level_neg": Estimate(float(p[1] - base)),
        }  # fmt: skip
        result.effects.append(FoundEffect("coulomb_asymmetry", joint, uneven))
    if measured.stiffness:
        damping = 0.6 * np.sqrt(measured.stiffness * measured.inertia)  # 0.3 of the critical
        bristles = {
            "stiffness": Estimate(measured.stiffness), "damping": Estimate(float(damping)),
        }  # fmt: skip
        result.effects.append(FoundEffect("presliding", joint, bristles))


def _draw(curves: Mapping[int, tuple[Measured, Curve]], folder: Path) -> str:
    figure, axes = make_figure(len(curves), 2)
    for row, (measured, curve) in zip(axes, curves.values(), strict=True):
        fastest = float(np.abs(measured.fast[:, 0]).max())
        _draw_panel(row[0], measured, curve, 1.12 * fastest, "all speeds")
        _draw_panel(row[1], measured, curve, 0.6 * measured.peak, "low speeds")
    handles, words = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, words, loc="outside lower center", ncols=3, fontsize=8, frameon=False,
        markerscale=3.0,
    )  # fmt: skip
    return save(figure, folder / "fit.png")


def _draw_panel(panel: Any, measured: Measured, curve: Curve, limit: float, words: str) -> None:
    v, f, slowing = measured.speed, measured.friction, measured.slowing
    panel.plot(
        v[~slowing], f[~slowing], ".", color="#a9bfd9", markersize=1.2,
        label="triangles, gaining speed: bristles bend",
    )  # fmt: skip
    panel.plot(
        v[slowing], f[slowing], ".", color=BLUE, markersize=1.2, label="triangles, losing speed"
    )
    panel.plot(
        measured.fast[:, 0], measured.fast[:, 1], "o", color=AMBER, markersize=4.5,
        label="constant torque, open loop",
    )  # fmt: skip
    for rest, sign in zip(measured.rest, (1, -1), strict=False):
        panel.plot(
            [0.0], [rest * sign], "D", color=GREY, markersize=5,
            label="breakaway" if sign > 0 else None,
        )  # fmt: skip
    for sign in (1, -1):
        x = sign * np.linspace(0.0, limit, 500)
        panel.plot(
            x, sign * curve.size(x), color=RED, linewidth=1.3,
            label="two polynomials, joined" if sign > 0 else None,
        )  # fmt: skip
        panel.axvline(sign * curve.split, color=GREY, linewidth=0.6, linestyle=":")
    panel.set_xlim(-limit, limit)
    inside = np.abs(v) < limit
    top = 1.15 * max(np.abs(f[inside]).max(), np.abs(curve.size(np.array([0.93 * limit])))[0])
    panel.set_ylim(-top, top)
    what = "torque" if measured.unit == "rad" else "force"
    label(
        panel, f"speed ({measured.unit}/s)", f"friction {what} ({measured.force})",
        f"joint {measured.joint}, {words}",
    )  # fmt: skip
