"""Friction of the planar arm as one curve: two polynomials of speed, joined, through the results of
three experiments.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zendsp.experiment import imi_breakaway, imi_friction
from zendsp.experiment.figures import AMBER, BLUE, GREY, RED, label, make_figure, save
from zendsp.experiment.lab import Lab, needed
from zendsp.experiment.result import Estimate, FoundEffect, Result, number

Array = npt.NDArray[np.float64]

SPLITS = np.arange(0.15, 0.81, 0.05)  # rad/s
SLOWEST = 0.03  # rad/s: below it the smoothing mixes both directions
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


def fit_curve(speed: Array, friction: Array, weight: Array) -> Curve:
    """Least-squares fit of the joined polynomials; of the ``SPLITS`` the one with the smallest
    residual.

    Parameters
    ----------
    speed, friction : ndarray, shape (N,)
        rad/s and N m, signed.
    weight : ndarray, shape (N,)
        Of each point.
    """
    best: Curve | None = None
    root = np.sqrt(weight)
    for split in SPLITS:
        A = _basis(speed, float(split))
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


def fit(lab: Lab) -> Result:
    """One friction curve for each joint, from the static, low-speed and viscous experiments; those
    that are missing are made first.
    """
    static = needed(lab, "breakaway", imi_breakaway.static)
    viscous = needed(lab, "high-speed", imi_friction.viscous)
    low = needed(lab, "low-speed", imi_friction.low_speed)
    result = Result(
        "friction-curve", "Friction curve of the planar arm", imi_friction.MACHINE,
        target=low.target,
    )
    folder = lab.folder / result.name
    folder.mkdir(parents=True, exist_ok=True)
    curves = {}
    for joint in imi_friction.JOINTS:
        with np.load(lab.folder / "low-speed" / f"curve{joint}.npz") as stored:
            v, f = stored["speed"], stored["friction"]
            # at the peaks the acceleration jumps, which the smoothing smears: they are left out
            sliding = (
                (np.abs(v) > SLOWEST) & (np.abs(v) < PEAK * np.abs(v).max()) & stored["slowing"]
            )
        fast = np.array(
            [
                (number(p, "speed rad/s"), number(p, "friction N m"))
                for p in viscous.tables["points"]
                if p["joint"] == joint
            ]
        )
        speed, friction = np.r_[v[sliding], fast[:, 0]], np.r_[f[sliding], fast[:, 1]]
        weight = np.r_[
            np.full(sliding.sum(), 1.0), np.full(len(fast), sliding.sum() / len(fast) / 3.0)
        ]
        curve = fit_curve(speed, friction, weight)
        curves[joint] = curve
        _report(result, joint, curve, static)
    result.figure = _draw(curves, static, viscous, lab, folder)
    result.recordings = [
        f"../{r.name}/{name}" for r in (static, low, viscous) for name in r.recordings
    ]
    return result


def _report(result: Result, joint: int, curve: Curve, static: Result) -> None:
    names = ("level_pos", "level_neg", "slope", "curve", "cubic", "high_curve")
    units = ("N m", "N m", "N m s/rad", "N m s^2/rad^2", "N m s^2/rad^2", "N m s^2/rad^2")
    p = curve.coefficients
    for name, unit, value, std in zip(names, units, p, curve.std, strict=True):
        result.values[f"joint{joint}_{name}"] = Estimate(float(value), float(std), unit)
    result.values[f"joint{joint}_split"] = Estimate(curve.split, 0.0, "rad/s")
    result.values[f"joint{joint}_rms"] = Estimate(curve.rms, 0.0, "N m")
    result.tables.setdefault("program", []).append(
        {
            "joint": joint,
            "low": [round(x, 6) for x in curve.low()],
            "high": [round(x, 6) for x in curve.high()],
            "split": curve.split,
        }
    )
    base = float(min(p[0], p[1]))
    stiffness = static.values[f"stiffness{joint}"].value
    damping = 0.6 * np.sqrt(stiffness * {1: 3.957, 2: 0.196}[joint])  # 0.3 of the critical
    rest = zip(("slope", "curve", "cubic", "high_curve"), p[2:], strict=True)
    block = {name: Estimate(float(value)) for name, value in rest}
    block |= {"level": Estimate(base, float(curve.std[0]), "N m"), "split": Estimate(curve.split)}
    uneven = {"level_pos": Estimate(float(p[0] - base)), "level_neg": Estimate(float(p[1] - base))}
    bristles = {"stiffness": Estimate(stiffness), "damping": Estimate(float(damping))}
    result.effects += [
        FoundEffect("friction_block", joint, block),
        FoundEffect("coulomb_asymmetry", joint, uneven),
        FoundEffect("presliding", joint, bristles),
    ]


def _draw(curves: dict[int, Curve], static: Result, viscous: Result, lab: Lab, folder: Path) -> str:
    figure, axes = make_figure(2, 2)
    for row, joint in zip(axes, imi_friction.JOINTS, strict=True):
        curve = curves[joint]
        with np.load(lab.folder / "low-speed" / f"curve{joint}.npz") as stored:
            v, f, slowing = stored["speed"], stored["friction"], stored["slowing"]
        fast = np.array(
            [
                (number(p, "speed rad/s"), number(p, "friction N m"))
                for p in viscous.tables["points"]
                if p["joint"] == joint
            ]
        )
        for axis, limit, words in ((row[0], 5.6, "all speeds"), (row[1], 0.6, "low speeds")):
            axis.plot(
                v[~slowing],
                f[~slowing],
                ".",
                color="#a9bfd9",
                markersize=1.2,
                label="triangles, gaining speed: bristles bend",
            )
            axis.plot(
                v[slowing], f[slowing], ".", color=BLUE, markersize=1.2,
                label="triangles, losing speed",
            )
            axis.plot(
                fast[:, 0], fast[:, 1], "o", color=AMBER, markersize=4.5,
                label="constant torque, open loop",
            )
            for word, sign in (("ccw", 1), ("cw", -1)):
                level = static.values[f"breakaway{joint}_{word}"].value * sign
                axis.plot(
                    [0.0], [level], "D", color=GREY, markersize=5,
                    label="breakaway" if sign > 0 else None,
                )
                x = sign * np.linspace(0.0, limit, 500)
                axis.plot(
                    x,
                    sign * curve.size(x),
                    color=RED,
                    linewidth=1.3,
                    label="two polynomials, joined" if sign > 0 else None,
                )
                axis.axvline(sign * curve.split, color=GREY, linewidth=0.6, linestyle=":")
            axis.set_xlim(-limit, limit)
            inside = np.abs(v) < limit
            top = 1.15 * max(
                np.abs(f[inside]).max(), np.abs(curve.size(np.array([min(limit, 5.2)])))[0]
            )
            axis.set_ylim(-top, top)
            label(axis, "speed (rad/s)", "friction torque (N m)", f"joint {joint}, {words}")
    handles, words = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, words, loc="outside lower center", ncols=3, fontsize=8, frameon=False,
        markerscale=3.0,
    )
    return save(figure, folder / "fit.png")
