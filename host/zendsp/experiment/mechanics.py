"""Inertia, weight and friction of every joint of any machine that takes torques, from smooth moves
both ways, within the limits that the machine states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from zendsp.diagnosis.data.series import stretches
from zendsp.errors import Refused
from zendsp.experiment import spun_shaft
from zendsp.experiment.any_friction import FOLLOWS, STIFFER, TRIES, fit_line
from zendsp.experiment.estimates import NORMAL, bump_means, least_squares, smoothed
from zendsp.experiment.figures import BLUE, RED, label, make_figure, save
from zendsp.experiment.lab import Bench, Lab, playing
from zendsp.experiment.result import Cell, Estimate, Result
from zendsp.experiment.sliding import ACTS, Friction, Sliding, found_friction
from zendsp.experiment.watch import firmer, widen
from zendsp.recording import Recording
from zendsp.reference import Reference
from zendsp_protocol.messages import JointInfo
from zendsp_protocol.views import with_std

Array = npt.NDArray[np.float64]

PROGRAM = "joint_pd.c"
CHANNELS = ("play_time", "q", "tau")
TRAVEL = 0.8  # rad or m, at most …
SHARE = 0.4  # … and of the range of the joint
ASIDE = 0.25  # of the travel, kept free at both ends of the range
SPEED = 0.4  # of the largest speed
TORQUE = 0.3  # of the largest torque, to accelerate
FASTEST = 0.8  # s, a move: the loop of joint_pd.c follows faster ones badly
SPREAD = 6.0  # slowest over fastest move
MOVES = 6  # durations, each there and back
GENTLE = 3  # cycles of the first motion, over a quarter of the way …
CALM = 2.0  # s, each move of it
KNOWN = 0.2  # of an inertia, its standard deviation at most where the loop is set by it
REST = 0.3  # s, after each move
LONGEST = 50.0  # s, all moves together: a table holds 60 s
PEAK, TURN = 1.875, 5.774  # largest speed and acceleration of a move of length and duration 1
SLIDES = 0.2  # of a move's largest speed: below, bristles bend
PIECES = 10  # of a move
WIDTH = 1.0 / 6.0  # of a move: what a piece averages over
FEWEST = 41  # samples of it


@dataclass(frozen=True)
class Moves:
    """A reference, and the first and last row of each of its moves."""

    reference: Reference
    rows: tuple[tuple[int, int], ...]


class Accelerated(Sliding):
    """Pieces of moves that accelerate; all are equally long parts of a move and weigh alike."""

    def weights(self) -> Array:
        """One, for each piece."""
        return np.ones_like(self.torque)


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
    with lab.bench(result.name) as bench:
        stands = bench.record("where_it_stands", PROGRAM, CHANNELS, seconds=0.2)
        place, told = np.atleast_1d(stands["q"][-1]), bench.machine.joints
        for joint in joints or [j for j, own in enumerate(told, 1) if own.command != "none"]:
            pieces = _measure(bench, joint, place)
            found = fit_line(pieces, told[joint - 1].unit == "rad")
            curves[joint] = pieces, found
            _report(result, joint, told[joint - 1].unit, found)
            mass = "inertia" if told[joint - 1].unit == "rad" else "mass"
            names = [f"{name}{joint}" for name in (mass, "coulomb", "viscous")]
            widen(result, joint, bench.seen, bench.inertias, names, bench.seen[joint].quickest)
        if len(told) == 1:
            _of_one_joint(result, told[0].unit, curves[1][1])
        result.recordings, result.target = bench.recordings, bench.where
        units = [j.unit for j in told]
        result.figure = save(_draw(curves, units), bench.folder / "mechanical.png")
    return result


def _measure(bench: Bench, joint: int, place: Array) -> Sliding:
    """A gentle motion first, which tells the inertia for the loop and for the accelerations; then
    slow to fast moves.
    """
    own = bench.machine.joints[joint - 1]
    travel, start = _way(own, float(place[joint - 1]))
    period = 1.0 / bench.target.status().rate_hz

    def moved(
        name: str, durations: list[float], way: float, **values: Any
    ) -> tuple[Recording, Moves]:
        moves = _moves(place, joint, start + (travel - way) / 2.0, way, durations, period)
        rec = bench.record(name, PROGRAM, CHANNELS, reference=moves.reference, before=2.0, **values)
        return rec, moves

    gentle, calm = f"joint{joint}_gentle", [CALM] * GENTLE
    rec, moves = moved(gentle, calm, travel / 4.0)
    inertias = np.atleast_1d(np.asarray(rec.parameters["J"], dtype=np.float64)).copy()
    tries = 0
    while (way := _followed(rec, joint)) < FOLLOWS * travel / 4.0:
        if tries == TRIES:
            raise Refused(
                f"{own.name}: does not follow its loop, of {travel / 4.0:.3g} {own.unit} it moves"
                f" {way:.3g}: let the machine declare a larger inertia of the joint"
            )
        tries += 1  # a light joint with much friction hardly gives way to its loop
        inertias[joint - 1] *= STIFFER
        rec, moves = moved(gentle, calm, travel / 4.0, J=inertias)
    told, rate = bench.machine.joints, bench.target.status().rate_hz
    while firm := firmer(bench.seen, joint, told, rate, inertias / bench.inertias):
        inertias[[j - 1 for j in firm]] *= STIFFER
        rec, moves = moved(gentle, calm, travel / 4.0, J=inertias)
    found = _inertia(weak_pieces(rec, moves, joint)) or 0.0
    inertias[joint - 1] = max(inertias[joint - 1], found)
    durations, way = _durations(own, travel, found or inertias[joint - 1])
    return weak_pieces(*moved(f"joint{joint}", durations, way, J=inertias), joint)


def _durations(own: JointInfo, travel: float, inertia: float) -> tuple[list[float], float]:
    """How long the moves take, slow to fast, and how far they go: less far than they might where
    the joint would take too long for that, or for its torque.
    """
    most = LONGEST / (2.0 * MOVES) - REST
    quick = max(
        FASTEST,
        PEAK * travel / (SPEED * own.speed_max),
        (TURN * travel * inertia / (TORQUE * own.torque_max)) ** 0.5,
    )
    if quick > most:
        travel, quick = travel * (most / quick) ** 2, most
    for spread in np.geomspace(SPREAD, 1.0, 20):  # closer together where all are slow
        durations = np.geomspace(spread, 1.0, MOVES) * quick
        if 2.0 * (durations.sum() + MOVES * REST) <= LONGEST:
            break
    return [float(d) for d in durations], travel


def _followed(rec: Recording, joint: int) -> float:
    """How far a joint moved while the reference was played."""
    q = np.atleast_2d(rec["q"].T).T[rec["play_time"] >= 0.0, joint - 1]
    return float(np.ptp(q))


def _way(joint: JointInfo, place: float) -> tuple[float, float]:
    """How far a joint moves, and from where: about its place, off the ends of its range."""
    low, high = joint.position_min, joint.position_max
    travel = min(TRAVEL, SHARE * (high - low), SPEED * joint.speed_max * CALM / PEAK)
    if not travel > 0.0:
        raise Refused(
            f"{joint.name}: its range is {low:g} to {high:g} {joint.unit}: no way to move"
        )
    aside = ASIDE * travel
    return travel, float(np.clip(place - travel / 2, low + aside, high - aside - travel))


def _moves(
    place: Array, joint: int, start: float, travel: float, durations: list[float], period: float
) -> Moves:
    """For each duration a move there and one back, without a jump of the acceleration, and rests.
    """
    way, rows, row = [], [], 0
    rest = round(REST / period)
    for duration in durations:
        n = round(duration / period)
        s = np.arange(n) / n
        share = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        for there in (share, 1.0 - share):
            way += [start + travel * there, np.full(rest, start + travel * round(there[-1]))]
            rows.append((row, row + n))
            row += n + rest
    q = np.tile(place, (row, 1))
    q[:, joint - 1] = np.concatenate(way)
    return Moves(Reference(q, period, kind="point_to_point", machine=""), tuple(rows))


def weak_pieces(rec: Recording, moves: Moves, joint: int) -> Accelerated:
    """Means over pieces of each move, where the joint slides.

    The torque is the one that acts during the sample.
    """
    rows = playing(rec, moves.reference.samples)
    q, tau = (np.atleast_2d(rec[name].T).T[rows][:, joint - 1] for name in ("q", "tau"))
    dt = rec.sample_time
    speed = smoothed(q, FEWEST, dt, 1)
    others = np.delete(np.atleast_2d(rec["q"].T).T[rows], joint - 1, axis=1)
    pieces = []
    for part, (first, last) in enumerate(moves.rows):
        last = min(last + round(REST / dt / 2), len(q))
        pace = np.abs(speed[first:last])
        runs = stretches(pace > SLIDES * pace.max())
        a, b = max(runs, key=lambda run: run[1] - run[0])
        n = max(FEWEST, round(WIDTH * (b - a)))
        for begin in np.unique(np.linspace(first + a, first + b - n, PIECES).astype(int)):
            if b - a > n and begin + n + 2 <= len(q):
                pieces.append((part, *_piece(q, tau, int(begin), n, dt)))
    if not pieces:
        raise Refused(f"joint {joint}: moves too little, or too briefly, to be measured")
    columns = np.array(pieces).T
    away = float(others.std(axis=0).max(initial=0.0))
    part, at, pace, torque, turn, rate = columns
    none = np.zeros_like(torque)
    # the drive's own lag, which nothing declares, is a share of the torque's rate
    return Accelerated(part.astype(np.int64), at, pace, torque, none, turn, away, (rate,))


def _piece(q: Array, tau: Array, begin: int, n: int, dt: float) -> tuple[float, ...]:
    """Position, speed, torque, acceleration, and rate of the torque, of one piece of n samples."""
    at = np.arange(begin, begin + n)
    acting = np.interp(at - ACTS, np.arange(len(tau)), tau)
    place, speed, turn = bump_means(q[at], dt)
    torque, rate, _ = bump_means(acting, dt)
    return place, speed, torque, turn, rate


def _inertia(gentle: Sliding) -> float | None:
    """The inertia that the first motion shows; None where it does not."""
    one = np.ones_like(gentle.q)
    A = np.stack(
        [gentle.acceleration, np.sign(gentle.speed), gentle.speed, one, gentle.q], axis=1
    )
    x, half, _ = least_squares(A, gentle.torque)
    return float(x[0]) if half[0] / NORMAL < KNOWN * x[0] else None


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
