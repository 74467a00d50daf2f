"""Inertia, weight and friction of every joint of any machine that takes torques, from smooth moves
both ways, within the limits that the machine states.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from zendsp.errors import Unmeasured
from zendsp.experiment import spun_shaft
from zendsp.experiment.any_friction import fit_line, with_coupling
from zendsp.experiment.demand import within_drive
from zendsp.experiment.estimates import NORMAL
from zendsp.experiment.figures import BLUE, RED, label, make_figure, save
from zendsp.experiment.gentle import (
    CALM,
    CHANNELS,
    LONGEST,
    PEAK,
    PROGRAM,
    REST,
    SHARE,
    SPEED,
    TRAVEL,
    Moves,
    approach_time,
    gentle_first,
    pushed_time,
    smooth_moves,
    weak_pieces,
)
from zendsp.experiment.knowing import refuse_none
from zendsp.experiment.lab import Bench, Lab
from zendsp.experiment.result import Cell, Estimate, Result
from zendsp.experiment.sliding import Friction, Sliding, found_friction
from zendsp.experiment.standing import standing
from zendsp.experiment.watch import left_out, widen
from zendsp_protocol.messages import JointInfo
from zendsp_protocol.views import with_std

Array = npt.NDArray[np.float64]

ASIDE = 0.25  # of the travel, kept free at both ends of the range
FASTEST = 0.8  # s, a move: the loop of joint_pd.c follows faster ones badly
SPREAD = 6.0  # slowest over fastest move
MOVES = 6  # durations, each there and back


def mechanical(lab: Lab, joints: tuple[int, ...] = ()) -> Result:
    """Inertia, weight, Coulomb and viscous friction of each joint.

    The pendulum's shaft is spun by its paper's torque law. Any other joint makes smooth moves both
    ways, slow to fast.

    Parameters
    ----------
    lab : Lab
    joints : tuple of int
        Which; default: all that have a drive.
    """
    name = lab.machine_of("mechanical")
    if lab.shipped("mechanical") == spun_shaft.MACHINE:
        return spun_shaft.mechanical(lab)
    result = Result("mechanical", "Inertia, weight and friction of every joint", name)
    curves: dict[int, tuple[Sliding, Friction]] = {}
    with lab.bench(result.name, result) as bench:
        place, told = standing(bench), bench.machine.joints
        for joint in joints or [j for j, own in enumerate(told, 1) if own.command != "none"]:
            with left_out(result, bench.target, joint):
                turns = told[joint - 1].unit == "rad"
                measured = _measure(bench, joint, place, result)
                pieces, coupled = with_coupling(measured, turns)
                found = fit_line(pieces, turns)
                curves[joint] = pieces, found
                _report(result, joint, told[joint - 1].unit, found)
                mass = "inertia" if turns else "mass"
                names = [f"{name}{joint}" for name in (mass, "coulomb", "viscous")]
                seen = {k: one for k, one in bench.seen.items() if k not in coupled}
                widen(result, joint, seen, bench.inertias, names, seen[joint].quickest)
        refuse_none(result, curves)
        if len(told) == 1:
            _of_one_joint(result, told[0].unit, curves[1][1])
        result.recordings, result.target = bench.recordings, bench.where
        units = [j.unit for j in told]
        result.figure = save(_draw(curves, units), bench.folder / "mechanical.png")
    return result


def _measure(bench: Bench, joint: int, place: Array, result: Result) -> Sliding:
    """A gentle motion first, which tells the inertia for the loop and what the drive has to give;
    then slow to fast moves.
    """
    own = bench.machine.joints[joint - 1]
    travel, start = _way(own, float(place[joint - 1]))
    inertias, found = gentle_first(bench, joint, place, start + travel / 2.0, travel)
    period = 1.0 / bench.target.status().rate_hz
    turned = found.inertia or float(inertias[joint - 1])

    def moving(share: float) -> Moves:
        durations, way = _durations(own, travel, turned, share)
        return smooth_moves(place, joint, start + (travel - way) / 2.0, way, durations, period)

    share, slower = within_drive(lambda x: moving(x).reference, found, own, joint)
    result.warnings += [slower] * bool(slower)
    moves = moving(share)
    rec = bench.record(
        f"joint{joint}", PROGRAM, CHANNELS, reference=moves.reference,
        before=approach_time(bench), J=inertias,
    )
    return replace(weak_pieces(rec, moves, joint), count=1.0 / abs(own.counts_per_unit))


def _durations(
    own: JointInfo, travel: float, inertia: float, share: float = 1.0
) -> tuple[list[float], float]:
    """How long the moves take, slow to fast, at a share of their speeds, and how far they go: less
    far than they might where the joint would take too long for that, or for its torque.
    """
    most = LONGEST / (2.0 * MOVES) - REST
    quick = max(
        FASTEST,
        PEAK * travel / (SPEED * own.speed_max),
        pushed_time(own, travel, inertia),
    ) / share
    if quick > most:
        travel, quick = travel * (most / quick) ** 2, most
    for spread in np.geomspace(SPREAD, 1.0, 20):  # closer together where all are slow
        durations = np.geomspace(spread, 1.0, MOVES) * quick
        if 2.0 * (durations.sum() + MOVES * REST) <= LONGEST:
            break
    return [float(d) for d in durations], travel


def _way(joint: JointInfo, place: float) -> tuple[float, float]:
    """How far a joint moves, and from where: about its place, off the ends of its range."""
    low, high = joint.position_min, joint.position_max
    calm = SPEED * joint.speed_max * CALM / PEAK  # a move of that time at its speed
    travel = min(TRAVEL, SHARE * (high - low), calm)
    if not travel > 0.0:
        raise Unmeasured(
            f"{joint.name}: its range is {low:g} to {high:g} {joint.unit}: no way to move"
        )
    aside = ASIDE * travel
    return travel, float(np.clip(place - travel / 2, low + aside, high - aside - travel))


def _report(result: Result, joint: int, unit: str, found: Friction) -> None:
    """Add a joint's numbers, its friction as effects, and warnings."""
    turns = unit == "rad"
    force, mass = ("N m", "kg m^2") if turns else ("N", "kg")
    level, viscous, dl, dv = found.mean
    numbers = {
        "inertia" if turns else "mass": (*found.inertia, mass),
        "coulomb": (level, dl, force),
        "viscous": (viscous, dv, f"{force} s/{unit}"),
    }
    numbers |= {name: (*weight, force) for name, weight in found.weights(turns).items()}
    row: dict[str, Cell] = {"joint": joint}
    for name, (value, half, of) in numbers.items():
        result.values[f"{name}{joint}"] = Estimate(value, half / NORMAL, of)
        row[name.replace("_", " ")] = with_std(value, half, of)
    result.tables.setdefault("joints", []).append(row)
    if turns and found.constant[1]:
        result.warnings.append(
            f"Joint {joint}: the way is too short, or friction too uneven, to show how its weight"
            " changes: it is taken as the same everywhere."
        )
    if found.inertia[0] - found.inertia[1] <= 0.0:
        result.warnings.append(
            f"Joint {joint}: its inertia is not told from zero: friction or weight hide it at these"
            " accelerations."
        )
    result.effects += found_friction(joint, found)


def _of_one_joint(result: Result, unit: str, found: Friction) -> None:
    """What a model of one joint takes in beside friction."""
    inertia = Estimate(found.inertia[0], found.inertia[1] / NORMAL, "kg m^2")
    if unit != "rad":
        result.mechanism["mass"] = replace(inertia, unit="kg")
        return
    result.mechanism["inertia"] = inertia
    (sine, half), (cosine, other) = found.sine, found.cosine
    if abs(cosine) <= other or not found.weight:
        result.mechanism["gravity"] = Estimate(sine, half / NORMAL, "N m")
        return
    result.findings.append(
        f"The joint hangs at {np.arctan2(-cosine, sine):.3f} rad: a model with the weight"
        " gravity sin q has its zero there."
    )


def _draw(curves: dict[int, tuple[Sliding, Friction]], units: list[str]) -> Figure:
    """Left: torque without weight and inertia over speed; right: torque without friction and weight
    over acceleration.
    """
    figure, axes = make_figure(len(curves), 2, width=8.0, height=2.6)
    for row, (joint, (pieces, found)) in zip(axes, curves.items(), strict=True):
        unit = units[joint - 1]
        force = "N m" if unit == "rad" else "N"
        row[0].plot(pieces.speed, found.free, ".", color=BLUE, markersize=4)
        up = pieces.speed > 0
        line = np.zeros_like(found.free)
        for word, sign, rows in (("+", 1.0, up), ("-", -1.0, ~up)):
            level, viscous = found.value[word][:2]
            line[rows] = sign * level + viscous * pieces.speed[rows]
            x = sign * np.array([0.0, np.abs(pieces.speed).max()])
            row[0].plot(x, sign * (level + viscous * np.abs(x)), color=RED, linewidth=1.0)
        label(row[0], f"speed ({unit}/s)", f"friction ({force})", f"joint {joint}")
        turning = found.free - line + found.inertia[0] * pieces.acceleration
        row[1].plot(pieces.acceleration, turning, ".", color=BLUE, markersize=4)
        x = np.array([pieces.acceleration.min(), pieces.acceleration.max()])
        row[1].plot(x, found.inertia[0] * x, color=RED, linewidth=1.0)
        label(row[1], f"acceleration ({unit}/s²)", f"the rest ({force})")
    return figure
