"""Friction of the WAM: each joint moves at constant speeds in both directions; torque and speed are
averaged and fitted by least squares, for each direction.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.experiment.estimates import NORMAL, line_fit
from zendsp.experiment.figures import BLUE, GREY, RED, label, make_figure, save
from zendsp.experiment.lab import Bench, Lab
from zendsp.experiment.result import Estimate, Result
from zendsp.experiment.sliding import (
    Sliding,
    cannot_separate,
    constant_speed_pieces,
    fit_friction,
    friction_effects,
)
from zendsp.reference import Reference, load_machine, make_trapezoid
from zendsp_protocol.views import with_std

Array = npt.NDArray[np.float64]

MACHINE = "wam7"
JOINTS = 7
SPEEDS = (0.08, 0.12, 0.2, 0.3, 0.45, 0.7, 1.0)  # rad/s
FEWEST = 4  # speeds: two directions of each, for seven numbers (friction, weight, inertia)
NARROW = (0.02, 0.03, 0.045)  # rad/s: what a table comes to when only such speeds are used …
# … shown on two of the joints for which the paper prints negative viscous friction
NARROW_JOINTS = (2, 4)
POSE = (0.0, 0.4, 0.0, 1.5, -1.5, 0.0, 0.0)  # rad, where the other joints stay
TRAVEL = 0.75  # rad: far enough to tell a weight that the model lacks from friction
DECIMATION = 4
DAC_STEP = 20000.0 / 4096.0  # mV: 12 bits over ±10 V
CHANNELS = ("play_time", "q", "tau", "g")
# Coulomb N m and viscous N m s/rad, positive and negative direction, of the seven-joint paper
PAPER = {
    1: (4.4748, 4.3609, 1.3348, 0.8266),
    2: (2.6385, 3.5643, 3.5572, -2.3951),
    3: (1.7399, 2.3529, 0.3944, 1.2075),
    4: (1.5414, 0.7342, -2.7045, -1.0969),
    5: (0.2798, 0.1172, -0.1972, 1.467),
    6: (0.4834, 0.4417, 0.8291, 0.1836),
    7: (0.0538, 0.1370, 1.0689, 0.7954),
}


def friction(
    lab: Lab,
    speeds: tuple[float, ...] = SPEEDS,
    joints: tuple[int, ...] = tuple(range(1, JOINTS + 1)),
    narrow: bool = True,
) -> Result:
    """Coulomb and viscous friction of every joint and direction, with confidence intervals, beside
    the paper's table. ``narrow``: also the result of slow speeds alone.

    Raises
    ------
    ValueError
        Fewer than ``FEWEST`` speeds.
    """
    if len(speeds) < FEWEST:
        raise ValueError(
            f"speeds = {speeds}: friction, weight and rotor are seven numbers of a joint; their"
            f" intervals need {FEWEST} speeds (two directions of each)"
        )
    result = Result("friction", "Friction maps of the WAM", MACHINE)
    curves: dict[int, Array] = {}
    with lab.bench(result.name, result) as bench:
        for joint in joints:
            wide = _map(bench, joint, speeds, TRAVEL, f"joint{joint}")
            curves[joint] = _fit_joint(result, joint, wide)
        slow = {
            joint: _map(bench, joint, NARROW, 0.15, f"joint{joint}_narrow")
            for joint in NARROW_JOINTS
            if narrow and joint in joints
        }
        result.recordings, result.target = bench.recordings, bench.where
        for joint, sliding in slow.items():
            _fit_narrow(result, joint, sliding.points(sliding.torque))
        result.figure = save(_draw(curves, result), bench.folder / "friction_maps.png")
    return result


def _map(bench: Bench, joint: int, speeds: tuple[float, ...], travel: float, name: str) -> Sliding:
    reference = _moves(joint, speeds, travel)
    rec = bench.record(
        name, "wam_pd_gravity.c", CHANNELS, reference=reference, before=3.0, decimation=DECIMATION
    )
    step = DAC_STEP / bench.machine.joints[joint - 1].mv_per_torque
    return replace(constant_speed_pieces(rec, reference, joint), step=step)


def _moves(joint: int, speeds: tuple[float, ...], travel: float) -> Reference:
    machine = load_machine(MACHINE)
    start = np.array(POSE)
    middle = start[joint - 1]
    start[joint - 1] = np.clip(
        middle - travel / 2,
        machine.limits.position_min[joint - 1] + 0.1,
        machine.limits.position_max[joint - 1] - 0.1 - travel,
    )
    return make_trapezoid(
        machine, joint=joint, start=start, travel=travel, speeds=speeds, acceleration=4.0, hold=0.3
    )


def _fit_joint(result: Result, joint: int, sliding: Sliding) -> Array:
    """Add a joint's friction to the result; return the points of its curve."""
    row: dict[str, int | float | str] = {"joint": joint}
    # about a vertical axis nothing weighs, and the model says so to the last digit
    fitted = fit_friction(sliding, weighs=bool(np.any(sliding.gravity)), unknown=True)
    found, points = fitted.value, sliding.points(fitted.free)
    result.values[f"gravity{joint}_lacking"] = Estimate(
        fitted.weight, fitted.weight_half / NORMAL, "N m"
    )
    for word, direction, paper in (("+", 1, (0, 2)), ("-", -1, (1, 3))):
        level, viscous, dl, dv = found[word]
        end = "pos" if direction > 0 else "neg"
        result.values[f"coulomb{joint}_{end}"] = Estimate(level, dl / NORMAL, "N m")
        result.values[f"viscous{joint}_{end}"] = Estimate(viscous, dv / NORMAL, "N m s/rad")
        row |= {
            f"Coulomb {word}": with_std(level, dl),
            f"paper C{word}": PAPER[joint][paper[0]],
            f"viscous {word}": with_std(viscous, dv),
            f"paper v{word}": PAPER[joint][paper[1]],
        }
        if cannot_separate(viscous, dv):
            chosen = points[np.sign(points[:, 0]) == direction]
            correlation = line_fit(chosen[:, 0], chosen[:, 1])[2]
            result.warnings.append(_warning(joint, word, chosen, viscous, dv, correlation))
    result.tables.setdefault("friction", []).append(row)
    result.effects += friction_effects(joint, fitted)
    return points


def _warning(
    joint: int, word: str, points: Array, viscous: float, half: float, correlation: float
) -> str:
    speeds = np.abs(points[:, 0])
    return (
        f"Joint {joint}, direction {word}: speeds of {speeds.min():.2g} to {speeds.max():.2g} rad/s"
        f" give a viscous coefficient of {with_std(viscous, half)} N m s/rad, which is no physical"
        f" constant: they cannot separate it from Coulomb friction (correlation {correlation:.3f})."
        " Use speeds over a decade."
    )


def _fit_narrow(result: Result, joint: int, points: Array) -> None:
    row: dict[str, int | float | str] = {"joint": joint}
    for word, direction, end in (("+", 1, "pos"), ("-", -1, "neg")):
        chosen = points[np.sign(points[:, 0]) == direction]
        (_, viscous), (_, half), correlation = line_fit(chosen[:, 0], chosen[:, 1])
        row |= {
            f"viscous {word}, {NARROW[0]:g} … {NARROW[-1]:g} rad/s": with_std(viscous, half),
            f"viscous {word}, all speeds": str(result.values[f"viscous{joint}_{end}"]),
        }
        narrow = Estimate(viscous, half / NORMAL, "N m s/rad")
        result.values[f"viscous{joint}_{end}_narrow"] = narrow
        if cannot_separate(viscous, half):
            result.warnings.append(_warning(joint, word, chosen, viscous, half, correlation))
    result.tables.setdefault("narrow range", []).append(row)


def _draw(maps: dict[int, Array], result: Result) -> Any:
    figure, axes = make_figure(2, 4, width=12.0, height=2.7)
    for axis, joint in zip(axes.flat, range(1, 9), strict=True):
        if joint not in maps:
            axis.set_axis_off()
            continue
        points = maps[joint]
        axis.errorbar(
            points[:, 0],
            points[:, 1],
            yerr=2 * points[:, 2],
            fmt="o",
            color=BLUE,
            markersize=3.5,
            linewidth=0.8,
            label="measured (bars: ± 2 σ)",
        )
        for end, sign, k in (("pos", 1, 0), ("neg", -1, 1)):
            x = sign * np.array([0.0, np.abs(points[:, 0]).max()])
            level = result.values[f"coulomb{joint}_{end}"].value
            slope = result.values[f"viscous{joint}_{end}"].value
            axis.plot(
                x,
                sign * (level + slope * np.abs(x)),
                color=RED,
                linewidth=1.0,
                label="fit" if sign > 0 else None,
            )
            paper = PAPER[joint]
            axis.plot(
                x,
                sign * (paper[k] + paper[k + 2] * np.abs(x)),
                color=GREY,
                linewidth=0.9,
                linestyle="--",
                label="paper's table" if sign > 0 else None,
            )
        label(axis, "speed (rad/s)", "friction (N m)", f"joint {joint}")
    handles, words = axes[0, 0].get_legend_handles_labels()
    figure.legend(
        handles, words, loc="lower right", bbox_to_anchor=(0.98, 0.16), fontsize=10, frameon=False
    )
    return figure
