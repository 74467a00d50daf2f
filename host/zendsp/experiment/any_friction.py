"""Friction of every joint of any machine that takes torques, from constant speeds in both
directions, within the limits that the machine states.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.series import stretches
from zendsp.errors import Unmeasured, ZendspError
from zendsp.experiment.demand import within_drive
from zendsp.experiment.estimates import NORMAL
from zendsp.experiment.figures import BLUE, RED, label, make_figure, save
from zendsp.experiment.gentle import (
    CHANNELS,
    FOLLOWS,
    PROGRAM,
    REST,
    SHARE,
    SPEED,
    TRAVEL,
    TRIES,
    approach_time,
    gentle_first,
    stride_of,
)
from zendsp.experiment.knowing import refuse_none
from zendsp.experiment.lab import Bench, Lab
from zendsp.experiment.ramps import GAVE, NO_CHANCE, Turned, ramped, without
from zendsp.experiment.result import Cell, Estimate, FoundEffect, Result
from zendsp.experiment.sliding import (
    MOVING,
    STEADY,
    Friction,
    Sliding,
    constant_speed_pieces,
    fit_friction,
    found_friction,
    unexplained,
)
from zendsp.experiment.standing import standing
from zendsp.experiment.watch import BEARS, LOOP, STIFFER, Held, left_out, look, widen
from zendsp.recording import Recording
from zendsp.reference import Reference
from zendsp_protocol.messages import JointInfo
from zendsp_protocol.views import with_std

Array = npt.NDArray[np.float64]
Line = tuple[float, float, float, float]  # level, viscous coefficient, their half widths

SPREAD = 6.0  # fastest over slowest speed: slower ones are those of Stribeck and bristles
CRUISE = 0.6  # s, at the fastest
RAMP = 0.15  # s
ENOUGH = 8  # moves: a line of each direction, the weight and the inertia are seven numbers
# times that a direction's level is less sure than the mean of both, from which on it is told: it is
# 1.4 where the weight is known, and was 24 for joint 1 of imi_planar
APART = 5.0
ONE_SIDED = 1.645  # standard deviations, that 5 % are beyond on one side


def friction(lab: Lab, speeds: int = 6, joints: tuple[int, ...] = ()) -> Result:
    """Coulomb and viscous friction of every joint and direction, and the weight that the joint
    moves.

    Parameters
    ----------
    lab : Lab
        With a target: the machine is whatever that has.
    speeds : int
        How many, in equal ratios.
    joints : tuple of int
        Which; default: all.
    """
    result = Result("friction", "Friction of every joint", lab.machine_of("friction"))
    curves: dict[int, tuple[Array, Friction]] = {}
    with lab.bench(result.name, result) as bench:
        place = standing(bench)
        all_joints = bench.target.machine().joints
        period = 1.0 / bench.target.status().rate_hz
        driven = tuple(i for i, j in enumerate(all_joints, 1) if j.command != "none")
        for joint in joints or driven:
            with left_out(result, bench.target, joint):
                own = all_joints[joint - 1]
                moves = partial(_moves, own, place, joint, speeds, period)
                reference, inertias, turned = _planned(bench, result, moves, joint, place)
                try:
                    sliding, rec = _record(bench, reference, joint, inertias, turned)
                except BaseException:
                    _of_part(result, bench, reference, joint)
                    raise
                curves[joint] = _found(result, bench, (sliding, rec, reference), joint)
        refuse_none(result, curves)
        result.recordings, result.target = bench.recordings, bench.where
        result.figure = _draw(curves, {i: j.unit for i, j in enumerate(all_joints, 1)}, bench)
    return result


def _found(
    result: Result, bench: Bench, measured: tuple[Sliding, Recording, Reference], joint: int
) -> tuple[Array, Friction]:
    """Add a joint's friction to the result; its points and its line.

    Parameters
    ----------
    measured : tuple
        Pieces of its moves, the recording that they are of, and the reference.
    """
    sliding, rec, reference = measured
    own = bench.machine.joints[joint - 1]
    unit, turns = own.unit, own.unit == "rad"
    counted = replace(sliding, count=1.0 / abs(own.counts_per_unit))
    sliding, coupled = with_coupling(counted, turns)
    found = fit_line(sliding, turns)
    if ramps := ramped(rec, reference, joint, found):
        sliding, found, coupled = surest(sliding, found, coupled, ramps, turns)
    _report(result, joint, unit, found)
    names = [f"{name}{joint}" for name in ("inertia", "coulomb", "viscous")]
    seen = {k: one for k, one in bench.seen.items() if k not in coupled}
    widen(result, joint, seen, bench.inertias, names, seen[joint].quick)
    return sliding.points(found.free), found


def _of_part(result: Result, bench: Bench, reference: Reference, joint: int) -> None:
    """Add a joint's friction by those of its moves that were made before all ended, where these are
    enough.
    """
    if bench.part is None or bench.part[0].name != f"joint{joint}_ended.npz":
        return
    rec = bench.part[1]
    moves = _steady(reference, joint)
    last = rec["play_time"].max() / reference.sample_time  # it begins anew where drives are off
    made = sum(end < last for _, end in moves)
    if made < ENOUGH:
        return
    rows = moves[made - 1][1]
    played = Reference(
        reference.q[:rows], reference.sample_time, kind=reference.kind, machine=""
    )
    # a part that tells nothing hides nothing of what ended the experiment
    with suppress(ZendspError, np.linalg.LinAlgError):
        joints = bench.machine.joints
        bench.seen = look(rec, played, Held.by(played, {}), [own.torque_max for own in joints])
        sliding = constant_speed_pieces(rec, played, joint, gravity=False)
        _found(result, bench, (sliding, rec, played), joint)
        result.warnings.append(
            f"Joint {joint}: measured by {made} of its {len(moves)} moves, slow ones first."
        )


def _steady(reference: Reference, joint: int) -> list[tuple[int, int]]:
    """First and last row of each of a joint's moves at constant speed."""
    pace, turn = reference.qd[:, joint - 1], reference.qdd[:, joint - 1]
    return stretches((np.abs(turn) < STEADY) & (np.abs(pace) > MOVING))


def _moves(
    joint: JointInfo, place: Array, number: int, speeds: int, period: float, share: float = 1.0
) -> Reference:
    """For each speed: ramp up, cruise, ramp down, rest, and the same back; at a share of the usual
    speeds.
    """
    low, high = joint.position_min, joint.position_max
    travel = min(TRAVEL, SHARE * (high - low))
    if not travel > 0.0:
        raise Unmeasured(
            f"{joint.name}: its range is {low:g} to {high:g} {joint.unit}: no way to move"
        )
    fastest = share * min(SPEED * joint.speed_max, travel / CRUISE)
    margin = 0.1 * travel
    start = float(np.clip(place[number - 1] - travel / 2, low + margin, high - margin - travel))
    ramp = RAMP / share
    moves, at = [], start
    for speed in np.geomspace(fastest / SPREAD, fastest, speeds):
        cruise = max(0.0, travel / speed - ramp)
        corners = np.cumsum([0.0, ramp, cruise, ramp, REST])
        t = np.arange(round(corners[-1] / period)) * period
        pace = np.interp(t, corners, [0.0, speed, speed, 0.0, 0.0])
        for direction in (1.0, -1.0):
            way = at + direction * np.cumsum(pace) * period
            moves.append(way)
            at = float(way[-1])
    way = np.concatenate(moves)
    stride = stride_of(len(way) * period, period)
    q = np.tile(place, (len(way[::stride]), 1))
    q[:, number - 1] = way[::stride]
    return Reference(q, stride * period, kind="trapezoid", machine="")


def _planned(
    bench: Bench, result: Result, moves: Callable[[float], Reference], joint: int, place: Array
) -> tuple[Reference, Array, float]:
    """A joint's moves, as fast as its drive can, after a gentle one which tells that; inertia of
    each joint for the loop, and what the joint itself turns at least as far as known.
    """
    column = moves(1.0).q[:, joint - 1]
    middle, travel = 0.5 * float(column.min() + column.max()), float(np.ptp(column))
    inertias, found = gentle_first(bench, joint, place, middle, travel)
    share, slower = within_drive(moves, found, bench.machine.joints[joint - 1], joint)
    result.warnings += [slower] * bool(slower)
    return moves(share), inertias, max(found.inertia, float(bench.inertias[joint - 1]))


def _record(
    bench: Bench, reference: Reference, joint: int, inertias: Array, turned: float
) -> tuple[Sliding, Recording]:
    """The pieces of a joint's moves, and the recording. Where it does not follow them its loop is
    made stiffer: a light joint with much friction hardly gives way to it.
    """
    rate = bench.target.status().rate_hz
    stride = round(reference.sample_time * rate)
    for tries in range(TRIES + 1):
        rec = bench.record(
            f"joint{joint}", PROGRAM, CHANNELS, reference=reference,
            before=approach_time(bench), decimation=2 * stride, J=inertias,
        )
        sliding = constant_speed_pieces(rec, reference, joint, gravity=False)
        share = _shares(sliding, reference, joint)
        each = share.min() > FOLLOWS and share.max() < 1.0 / FOLLOWS
        stiffer = STIFFER * inertias[joint - 1]
        ends = share[[0, 1, -2, -1]].min() > FOLLOWS
        if each or (ends and LOOP * stiffer > BEARS * rate * turned):
            return sliding, rec
        if tries < TRIES:
            inertias[joint - 1] = stiffer
    name = bench.machine.joints[joint - 1].name
    raise Unmeasured(
        f"{name}: does not follow its loop: let the machine declare a larger inertia of the joint"
    )


def _shares(sliding: Sliding, reference: Reference, joint: int) -> Array:
    """The speed of each part over that which it was to have."""
    pace = reference.qd[:, joint - 1]
    wanted = np.array([pace[a:b].mean() for a, b in _steady(reference, joint)])
    which = np.unique(sliding.part)
    return np.asarray(sliding.points(sliding.torque)[:, 0] / wanted[which])


def surest(
    sliding: Sliding, found: Friction, coupled: tuple[int, ...], ramps: Turned, may_weigh: bool
) -> tuple[Sliding, Friction, tuple[int, ...]]:
    """The surer of two lines, with its pieces and the held joints whose coupling is known: the one
    that was fitted beside the inertia, or with that of the ramps; and this where that other inertia
    contradicts it. At constant speed a friction that varies with place accelerates in time with
    itself, which looks like an inertia: on the planar arm of up to 0.76 kg m^2 for 0.196.
    """
    other, more = with_coupling(without(replace(sliding, further=()), ramps), may_weigh)
    beside = fit_line(other, may_weigh)
    (own, half), unsure = found.inertia, NORMAL * ramps.inertia_std
    if beside.mean[3] >= found.mean[3] and abs(own - ramps.inertia) <= math.hypot(half, unsure):
        return sliding, found, coupled
    return other, beside, (*ramps.coupled, *more)


def with_coupling(sliding: Sliding, may_weigh: bool) -> tuple[Sliding, tuple[int, ...]]:
    """The pieces with the accelerations of held joints that gave way, where these explain more of
    the torque than chance would once in a hundred times, by parts of the way; and which joints.

    A joint k that gives way takes M_jk qdd_k of the torque of joint j, in time with the motion:
    beside what a joint itself turns that looks like friction. It is felt most in fast moves, so
    all pieces count alike here; those of a coarse encoder would hardly count in the fit.
    """
    from scipy.special import fdtri

    parts = len(np.unique(sliding.part))
    taken: tuple[int, ...] = ()
    least = GAVE * float(np.std(sliding.acceleration))
    gave = {k for k, turn in sliding.turns.items() if np.std(turn) > least}
    squares = unexplained(sliding.alike(), may_weigh)
    while left := gave - set(taken):
        more = {k: replace(sliding, further=(*sliding.further, sliding.turns[k])) for k in left}
        tried = {k: unexplained(x.alike(), may_weigh) for k, x in more.items()}
        best = min(tried, key=lambda k: tried[k])
        free = parts - 5 - 2 * may_weigh - len(more[best].further)
        if free < 1 or squares - tried[best] <= fdtri(1, free, NO_CHANCE) * tried[best] / free:
            break
        sliding, squares, taken = more[best], tried[best], (*taken, best)
    return sliding, taken


def fit_line(sliding: Sliding, may_weigh: bool) -> Friction:
    """Friction and weight that explain a joint's torque.

    A weight is two more coefficients; it is kept where chance would explain as much only once in a
    hundred times (F test). Friction that varies with place does so alike at every speed, so one
    part of the way counts as one measurement. A weight that is not kept is not excluded: the
    intervals hold what would be found beside it. Where friction would have to drive the joint, the
    way is too short, or friction too uneven, to tell weight from what the directions differ by:
    they are alike, and the weight is the same everywhere, or changes as that of a turning mass,
    whichever explains more (both have as many numbers).
    """
    from scipy.special import fdtri

    plain = _falling(sliding, False)
    if not may_weigh:
        return _even(plain)
    found = _falling(sliding, True)
    free = len(np.unique(sliding.part)) - 7 - len(sliding.further)
    without, within = plain.squares, found.squares
    more = free > 0 and (without - within) / 2 > fdtri(2, free, NO_CHANCE) * within / free
    if not more:
        value = {way: _holding(line, found.value[way]) for way, line in plain.value.items()}
        widest = max(plain.inertia[1], found.inertia[1])
        found = replace(
            plain, value=value, mean=_holding(plain.mean, found.mean),
            weight_half=found.weight_half, sine=_holding_none(found.sine),
            cosine=_holding_none(found.cosine), inertia=(plain.inertia[0], widest),
        )
    both = (*plain.value.values(), *found.value.values())
    if not any(level + half < 0.0 for level, _, half, _ in both):
        return found
    alike = fit_friction(sliding, True, unknown=True, both=True)
    return alike if alike.squares < plain.squares else _even(plain)


def _falling(sliding: Sliding, weighs: bool) -> Friction:
    """The line of friction over speed, with a part that falls with speed where that explains more
    than chance.

    The shape over speed is the same at every place, so here each piece is a measurement.
    """
    from scipy.special import fdtri

    found = fit_friction(sliding, weighs, unknown=True)
    slow = np.geomspace(0.6, SPREAD, 24) * float(np.abs(sliding.speed).min())
    fastest = min(slow, key=lambda v: unexplained(sliding, weighs, float(v)))
    best = fit_friction(sliding, weighs, unknown=True, slow=float(fastest))
    free = len(sliding.torque) - 9
    more = (found.squares - best.squares) / 2 > fdtri(2, free, NO_CHANCE) * best.squares / free
    if not more or best.excess <= best.excess_half:
        return found
    whole = fit_friction(sliding, weighs, unknown=True, slow=best.slow, about=True)
    if whole.mean[0] > whole.mean[2]:
        return replace(whole, excess=best.excess)
    # what it would end in is not told from nothing: no fall, but so uncertain is the line too
    value = {way: _wider(line, whole.value[way]) for way, line in found.value.items()}
    return replace(found, value=value, mean=_wider(found.mean, whole.mean))


def _wider(line: Line, beside: Line) -> Line:
    """A line with half widths at least those of another one."""
    level, viscous, half, dv = line
    return level, viscous, max(half, beside[2]), max(dv, beside[3])


def _holding(line: Line, other: Line) -> Line:
    """A line whose 95 % intervals hold those of another one, which may be the right one instead.
    Where that is far off, its interval reaches beyond on one side only.
    """
    level, viscous, half, dv = _wider(line, other)
    apart = abs(level - other[0]), abs(viscous - other[1])
    one = ONE_SIDED / NORMAL
    return level, viscous, max(half, apart[0] + one * other[2]), max(dv, apart[1] + one * other[3])


def _holding_none(part: tuple[float, float]) -> tuple[float, float]:
    """No weight, with an interval that holds the one that was found, and half width."""
    return 0.0, abs(part[0]) + ONE_SIDED / NORMAL * part[1]


def _even(found: Friction) -> Friction:
    """Friction of a joint whose weight is the same everywhere, as where it slides. That cannot be
    told from a friction that is larger in one direction; the difference of the directions is called
    weight.
    """
    level, _, half, _ = found.mean
    weight = 0.5 * (found.value["+"][0] - found.value["-"][0])
    value = {way: (level, viscous, half, dv) for way, (_, viscous, _, dv) in found.value.items()}
    free = found.free - weight
    return replace(found, value=value, uneven=False, free=free, weight=abs(weight),
                   weight_half=found.apart_half, constant=(weight, found.apart_half), alike=True)


def _report(result: Result, joint: int, unit: str, found: Friction) -> None:
    force = "N m" if unit == "rad" else "N"
    row: dict[str, Cell] = {"joint": joint}
    ways = () if found.alike else (("+", "pos"), ("-", "neg"))
    if found.alike:
        result.warnings.append(
            f"Joint {joint}: nothing tells friction that differs between the directions from"
            " weight: it is taken as alike in both."
        )
    for word, end in ways:
        level, viscous, dl, dv = found.value[word]
        result.values[f"coulomb{joint}_{end}"] = Estimate(level, dl / NORMAL, force)
        result.values[f"viscous{joint}_{end}"] = Estimate(viscous, dv / NORMAL, f"{force} s/{unit}")
        row |= {f"Coulomb {word}": with_std(level, dl, force)}
        row |= {f"viscous {word}": with_std(viscous, dv, f"{force} s/{unit}")}
        if viscous - dv <= 0.0:
            result.warnings.append(
                f"Joint {joint}, direction {word}: the viscous coefficient"
                f" {with_std(viscous, dv, f'{force} s/{unit}')} is not told from zero at these"
                " speeds."
            )
    if found.excess:
        result.warnings.append(
            f"Joint {joint}: friction falls with speed, by {found.excess:.2g} {force} below about"
            f" {found.slow:.2g} {unit}/s (Stribeck). What is stated is the line that it ends in;"
            " the effect stribeck holds the rest."
        )
        breakaway = found.mean[0] + found.excess
        result.effects.append(
            FoundEffect(
                "stribeck",
                joint,
                {"breakaway": Estimate(breakaway, 0.0), "velocity": Estimate(found.slow, 0.0)},
            )
        )
    level, viscous, dl, dv = found.mean
    if ways and (apart := found.value["+"][2]) > APART * dl:
        result.warnings.append(
            f"Joint {joint}: of coulomb{joint}_pos and coulomb{joint}_neg a weight that is the same"
            f" along the way makes one larger and the other smaller: each is known to"
            f" ± {apart / NORMAL:.2g} {force} only. Go by coulomb{joint}, their mean"
            f" (± {dl / NORMAL:.2g} {force})."
        )
    row["Coulomb"] = with_std(level, dl, force)
    row["viscous"] = with_std(viscous, dv, f"{force} s/{unit}")
    result.values[f"coulomb{joint}"] = Estimate(level, dl / NORMAL, force)
    result.values[f"viscous{joint}"] = Estimate(viscous, dv / NORMAL, f"{force} s/{unit}")
    for name, (weight, dw) in found.weights(unit == "rad").items():
        result.values[f"{name}{joint}"] = Estimate(weight, dw / NORMAL, force)
        row[name.replace("_", " ")] = with_std(weight, dw, force)
    result.tables.setdefault("friction", []).append(row)
    if level - dl <= 0.0:
        result.warnings.append(
            f"Joint {joint}: the Coulomb level {with_std(level, dl, force)} is not told from zero."
        )
    result.effects += found_friction(joint, found)


def _draw(
    curves: dict[int, tuple[Array, Friction]], units: Mapping[int, str], bench: Bench
) -> str:
    columns = min(4, len(curves))
    figure, axes = make_figure(-(-len(curves) // columns), columns, width=3.0 * columns, height=2.7)
    for axis, (joint, (points, found)) in zip(axes.flat, curves.items(), strict=False):
        axis.errorbar(
            points[:, 0], points[:, 1], yerr=2 * points[:, 2], fmt="o", color=BLUE, markersize=3.5
        )
        for word, sign in (("+", 1.0), ("-", -1.0)):
            level, viscous = found.value[word][:2]
            x = sign * np.array([0.0, np.abs(points[:, 0]).max()])
            axis.plot(x, sign * (level + viscous * np.abs(x)), color=RED, linewidth=1.0)
        unit = units[joint]
        force = "N m" if unit == "rad" else "N"
        label(axis, f"speed ({unit}/s)", f"friction ({force})", f"joint {joint}; bars: ± 2 σ")
    return save(figure, bench.folder / "friction.png")
