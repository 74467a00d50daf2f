"""Watches the joints of an experiment: a drive at its limit, and held joints that give way."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import Refused, Unmeasured, ZendspError
from zendsp.experiment.result import Estimate, FoundEffect, Result
from zendsp.link import Target
from zendsp.link.outside import positions
from zendsp.recording import Recording
from zendsp.reference import Reference
from zendsp_protocol.messages import JointInfo, Limits, Trip
from zendsp_protocol.states import TripReason

Array = npt.NDArray[np.float64]

# The numbers behind these: docs/measurements/experiments.md, "Joints that are held".
AT_LIMIT = 0.03  # of the rows, that a command may be at its limit
UNSAFE = 0.1  # of its range, that a held joint may be pushed off its place to either side
MATTERS = 0.05  # of the way of the joint that moves, from which a held one is named
FREE = 1e9  # rad or m: instead of an infinite limit, which no message can set
LARGER = 4.0  # times, that the motion after the gentle one is
STIFFER = 3.0  # times, that the loop of a held joint is made
# rad/s, crossover of the speed loop of joint_pd.c at 3 Hz; and what a loop bears, times the rate:
# two samples of delay are then a quarter of a radian
LOOP, BEARS = 4.0 * np.pi * 3.0, 0.125
FIX = "Let the machine declare a larger inertia of it (its loop is stiffer then), or fix it"
WAYS = ("", "_pos", "_neg")  # both directions of friction together, and each
BEFORE = 0.5  # s before a trip, in which the command is looked at
STANDS = 0.5  # of its way: a joint that moves less was to move and did not


class AtLimit(Unmeasured):
    """The command of a joint that moves was at its limit."""


@dataclass(frozen=True)
class Held:
    """Joints that an experiment holds, by their number from 1, and where; those that move; and the
    ends of their ways and their largest speeds, rad/s or m/s, where these are known.
    """

    places: Mapping[int, float]
    moving: tuple[int, ...]
    ways: Mapping[int, tuple[float, float]] = field(default_factory=dict)
    speeds: Mapping[int, float] = field(default_factory=dict)

    @classmethod
    def by(cls, reference: Reference | None, values: Mapping[str, Any]) -> Held:
        """What a reference holds, or a push; nothing where neither is given."""
        ways, speeds = {}, {}
        if reference is not None:
            still = np.ptp(reference.q, axis=0) <= 0.0
            first = reference.q[0]
            low, high = reference.q.min(axis=0).tolist(), reference.q.max(axis=0).tolist()
            ends = enumerate(zip(low, high, strict=True), 1)
            ways = {j: way for j, way in ends if not still[j - 1]}
            fast = enumerate(np.abs(reference.qd).max(axis=0).tolist(), 1)
            speeds = {j: speed for j, speed in fast if j in ways}
        elif "place" in values and "joint" in values:
            first = np.atleast_1d(np.asarray(values["place"], dtype=np.float64))
            still = np.arange(1, len(first) + 1) != values["joint"]
        else:
            return cls({}, ())
        places = {j: float(x) for j, x in enumerate(first, 1) if still[j - 1]}
        moving = tuple(j for j in range(1, len(first) + 1) if j not in places)
        return cls(places, moving, ways, speeds)


@dataclass(frozen=True)
class Seen:
    """What a recording shows of one joint.

    Attributes
    ----------
    at_limit : float
        Share of the rows with the command at its limit.
    way, wanted : float
        How far it moved, and was to move, rad or m.
    away : float
        The farthest from where it was to be, rad or m.
    fast, quick, quickest : float
        The reference's largest speed, and the mean and the largest size of its acceleration while
        it moves; rad, s (m, s of a slide).
    """

    at_limit: float
    way: float
    wanted: float
    away: float
    fast: float = 0.0
    quick: float = 0.0
    quickest: float = 0.0


def look(
    rec: Recording, reference: Reference | None, held: Held, limits: Sequence[float]
) -> dict[int, Seen]:
    """What a recording shows of every joint, from when it was to follow; by its number. Of a push
    the joints that are held.
    """
    n = len(limits)
    rows, wanted = _rows(rec, reference, held, n)
    q = rec["q"].reshape(-1, n)[rows]
    if not len(q):
        return {}
    tau = np.abs(rec["tau"].reshape(-1, n)[rows]) if "tau" in rec else np.zeros_like(q)
    full = (tau >= np.array(limits) * (1.0 - 1e-6)).mean(axis=0)
    way, off = np.ptp(q, axis=0), np.abs(q - wanted[: len(q)]).max(axis=0)
    asked = np.ptp(wanted, axis=0)
    paces = _paces(reference, n)
    told = held.places if reference is None else range(1, n + 1)
    columns = np.stack([full, way, asked, off, *paces], axis=1)
    return {j: Seen(*columns[j - 1].tolist()) for j in told}


def _rows(
    rec: Recording, reference: Reference | None, held: Held, n: int
) -> tuple[npt.NDArray[np.bool_], Array]:
    """Rows in which the joints were to follow, and where they were to be in each."""
    if reference is not None and "play_time" in rec:
        t = rec["play_time"]
        rows = (t >= 0.0) & (t <= reference.duration)
        at = np.arange(reference.samples) * reference.sample_time
        return rows, np.stack([np.interp(t[rows], at, x) for x in reference.q.T], axis=1)
    rows = (rec["phase"] >= 1) & (rec["phase"] <= 2) if "phase" in rec else np.ones(len(rec), bool)
    wanted = rec["q"].reshape(-1, n)[rows].copy()
    for j, place in held.places.items():
        wanted[:, j - 1] = place
    return rows, wanted


def _paces(reference: Reference | None, n: int) -> tuple[Array, Array, Array]:
    """`Seen.fast`, `Seen.quick` and `Seen.quickest` of every joint."""
    if reference is None:
        return np.zeros(n), np.zeros(n), np.zeros(n)
    pace = np.abs(reference.qd)
    fast = pace.max(axis=0)
    moves = pace > 1e-3 * fast
    gains = np.abs(reference.qdd) * moves
    return fast, gains.sum(axis=0) / np.maximum(moves.sum(axis=0), 1), gains.max(axis=0)


def check(
    name: str, seen: Mapping[int, Seen], joints: Sequence[JointInfo], held: Held, limits: Limits
) -> None:
    """Refuse a recording in which a command was at its limit, or a held joint gave way too far.

    Raises
    ------
    AtLimit
        The command of a joint that moves was: others may still be measured.
    Refused
        A joint that was to be held was not: nothing is moved any more.
    """
    for j, one in seen.items():
        own = joints[j - 1]
        force = "N m" if own.unit == "rad" else "N"
        if one.at_limit > AT_LIMIT and own.command in ("torque", "force"):
            does = f"was to be held and gave way by {one.away:.3g} {own.unit}"
            if j in held.moving:
                does = f"moves {one.way:.3g} of {one.wanted:.3g} {own.unit}"
            raise (AtLimit if j in held.moving else Refused)(
                f"{name}: the command of joint {j} ({own.name}) is at its limit of"
                f" {limits.torque_max[j - 1]:g} {force} in {one.at_limit:.0%} of the samples, and"
                f" the joint {does}: friction or weight take more than the drive gives. Nothing is"
                " stated. Put the joint where it weighs less, or raise the limit if the drive bears"
                " it"
            )
        room = own.position_max - own.position_min
        if j in held.places and one.away > UNSAFE * room:
            raise Refused(f"{name}: {too_far(own, j, held, one.away)}")


def too_far(own: JointInfo, joint: int, held: Held, away: float) -> str:
    """A sentence on a held joint that is off its place."""
    moves = " and ".join(f"joint {j}" for j in held.moving)
    room = own.position_max - own.position_min
    return (
        f"joint {joint} ({own.name}) was to be held while {moves} moves, and gave way by"
        f" {away:.3g} {own.unit}, {away / room:.0%} of its range of {room:.3g} {own.unit}"
        f" ({UNSAFE:.0%} are allowed). No larger move is made. {FIX}; where its command is at its"
        " limit, put it where it weighs less"
    )


@contextmanager
def guarded(target: Target, name: str, held: Held) -> Iterator[None]:
    """A block in which a held joint that gives way too far trips the target at once, and so does
    one that leaves its way by as much as that way is long, or as far as a held one may: limits of
    position are tightened about place or way, and about where a joint stands now. Then they are as
    before, an infinite one as ``FREE``.

    Raises
    ------
    Refused
        It tripped so.
    """
    infos, before = target.machine().joints, target.limits()
    here = np.atleast_1d(np.asarray(positions(target.status(), infos), dtype=np.float64))
    low, high = (np.clip(x, -FREE, FREE) for x in (before.position_min, before.position_max))
    least, most = low.copy(), high.copy()
    for j, (first, last) in _ways(held).items():
        room = UNSAFE * (infos[j - 1].position_max - infos[j - 1].position_min)
        if j in held.ways:
            room = min(room, last - first)
        least[j - 1] = max(low[j - 1], min(first, here[j - 1]) - room)
        most[j - 1] = min(high[j - 1], max(last, here[j - 1]) + room)
    if (least == low).all() and (most == high).all():
        yield
        return
    target.set_limits(position_min=least.tolist(), position_max=most.tolist())
    try:
        yield
    except ZendspError as error:
        trip = target.status().trip if target.alive else None
        if trip is not None and (said := _gave_way(trip, infos, held)):
            raise Refused(f"{name}: {said}. The machine stopped: acknowledge it first") from error
        raise
    finally:
        with suppress(ZendspError):  # a target that is gone, or another program's
            target.set_limits(position_min=low.tolist(), position_max=high.tolist())


def _ways(held: Held) -> dict[int, tuple[float, float]]:
    """The first and last place at which each joint is to be."""
    return {**{j: (place, place) for j, place in held.places.items()}, **held.ways}


def _gave_way(trip: Trip, infos: Sequence[JointInfo], held: Held) -> str:
    """A sentence where a trip is that of a joint that was held, or that left its way, or its speed;
    else "".
    """
    own = infos[trip.joint - 1]
    name = f"joint {trip.joint} ({own.name})"
    if trip.reason == TripReason.SPEED and trip.joint in held.ways:
        return (
            f"{name} was to move at up to {held.speeds[trip.joint]:.3g} {own.unit}/s and came to"
            f" {abs(trip.value):.3g}, beyond its limit of {trip.limit:.3g}"
        )
    if trip.reason != TripReason.POSITION or trip.joint not in _ways(held):
        return ""
    first, last = _ways(held)[trip.joint]
    if trip.joint in held.places:
        return too_far(own, trip.joint, held, abs(trip.value - first))
    return (
        f"{name} was to move from {first:.3g} to {last:.3g} {own.unit} and came to"
        f" {trip.value:.3g}. An experiment stops a joint that leaves its way by as much as that is"
        f" long, or by {UNSAFE:.0%} of its range"
    )


def cause(trip: Trip | None, rec: Recording | None, joints: Sequence[JointInfo], held: Held) -> str:
    """Why a joint that moves left its way or its speed, and what to do, in sentences; "" where that
    is not what a trip is of. ``rec``: what was recorded by then.
    """
    if trip is None or trip.joint not in held.ways:
        return ""
    own = joints[trip.joint - 1]
    if rec is not None and {"tau", "play_time"} <= set(rec.names) and len(rec):
        end = float(rec["play_time"].max())  # it begins anew where drives are off
        last = rec["play_time"] > end - BEFORE
        tau = np.abs(rec["tau"].reshape(len(rec), -1)[last, trip.joint - 1])
        full = float((tau >= own.torque_max * (1.0 - 1e-6)).mean())
        if full > AT_LIMIT:
            force = "N m" if own.unit == "rad" else "N"
            return (
                f"Its command was at its limit of {own.torque_max:g} {force} (torque_max) in"
                f" {full:.0%} of the last {BEFORE:g} s: its drive does not turn round what it moves"
                " so fast. Let the machine declare the inertia that it has, if that is another; or"
                " a smaller speed_max, or a larger torque_max if the drive bears it"
            )
    if trip.reason == TripReason.SPEED:
        return (
            "Friction held it where it turns round and let it go, or it carries more than its loop"
            " holds. Let the machine declare a larger inertia of it (its loop is stiffer then), or"
            " a larger speed_max if it bears that"
        )
    if trip.reason == TripReason.POSITION:
        return (
            "Its loop does not hold what it moves. Look at the inertia that the machine declares of"
            " it, and at what it carries"
        )
    return ""


@contextmanager
def left_out(result: Result, target: Target, joint: int) -> Iterator[None]:
    """A block that measures a joint; where that is no measurement the result says so, and the
    experiment goes on with the others, unless the machine has stopped.
    """
    try:
        yield
    except Unmeasured as error:
        if target.status().trip is not None:
            raise
        result.warnings.append(f"Joint {joint} is left out: {error}.")


def firmer(
    seen: Mapping[int, Seen], joint: int, joints: Sequence[JointInfo], rate_hz: float, stiff: Array
) -> list[int]:
    """Held joints whose loop is to be made stiffer after a gentle motion, and whose sampling allows
    it.

    Parameters
    ----------
    stiff : ndarray
        How much stiffer the loop of each joint is than joint_pd.c's own.

    Raises
    ------
    Unmeasured
        One gives way so far that the next, larger motion would take it too far, and its loop cannot
        be made stiffer.
    """
    held = Held({k: 0.0 for k in seen if k != joint}, (joint,))
    firm = []
    for k in held.places:
        one, own = seen[k], joints[k - 1]
        unsafe = LARGER * one.away > UNSAFE * (own.position_max - own.position_min)
        if not unsafe and one.way <= MATTERS * seen[joint].way:
            continue
        if LOOP * STIFFER * stiff[k - 1] <= BEARS * rate_hz:
            firm.append(k)
        elif unsafe:
            raise Unmeasured(too_far(own, k, held, one.away))
    return firm


def stood(name: str, joint: int, seen: Mapping[int, Seen], own: JointInfo) -> None:
    """Refuse a recording in which a joint that was to move did not.

    Raises
    ------
    Unmeasured
    """
    one = seen[joint]
    if one.way < STANDS * one.wanted:
        raise Unmeasured(
            f"{name}: joint {joint} ({own.name}) was to move {one.wanted:.3g} {own.unit} and moved"
            f" {one.way:.3g}, with a command below its limit: its loop is too weak for its"
            " friction. Nothing is stated. Let the machine declare a larger inertia of the joint"
        )


def name_yielding(
    result: Result, joint: int, way: float, others: Mapping[int, float]
) -> None:
    """Warn of held joints that gave way by enough to matter, by the way of each."""
    for k, other in others.items():
        if other > MATTERS * way:
            result.warnings.append(
                f"Joint {k} was to be held while joint {joint} moved, and gave way by"
                f" {other / max(way, 1e-12):.0%} of its way: the numbers of joint {joint} are as"
                f" uncertain as that may have changed them. {FIX}."
            )


def widen(
    result: Result, joint: int, seen: Mapping[int, Seen], inertias: Array, names: Sequence[str],
    acceleration: float,
) -> None:
    """Add to the numbers of a joint what held joints that gave way may have changed of them, and
    name those that gave way by enough to matter, where that is more than the ± they had.

    A held joint k that goes along by a share s of the way takes M_jk s qdd of the torque of joint
    j. M is positive definite, so |M_jk| <= sqrt(M_jj M_kk). Friction is off by that, its slope by
    that over the speed.

    Parameters
    ----------
    inertias : ndarray
        Of every joint, as the machine declares them.
    names : sequence of str
        Keys of ``result.values``: the inertia (may be missing), friction's level and its slope;
        those of each direction, where they are stated, end in ``_pos`` and ``_neg``.
    acceleration : float
        Of the rows that they are measured by.
    """
    one = seen[joint]
    said = [result.values[names[0]].value] if names[0] in result.values else []
    own = max([*said, float(inertias[joint - 1])])
    off = 0.0
    for k, other in seen.items():
        share = other.way / max(one.way, 1e-12)
        if k == joint:
            continue
        off += share * (own * float(inertias[k - 1])) ** 0.5
    torque = off * acceleration
    each = zip(names, (off, torque, torque / max(one.fast, 1e-12)), strict=True)
    more = {f"{name}{way}": x for name, x in each for way in WAYS}
    keys = more.keys() & result.values.keys()
    if any(more[key] > result.values[key].std for key in keys):
        ways = {k: other.way for k, other in seen.items() if k != joint}
        name_yielding(result, joint, one.way, ways)
    for key in keys:
        result.values[key] = _wider(result.values[key], more[key])
    parts = {f"level{way}": torque for way in WAYS}
    parts |= {f"coefficient{way}": more[names[2]] for way in WAYS}
    for at, effect in enumerate(result.effects):
        if effect.joint == joint:
            parameters = {n: _wider(e, parts.get(n, 0.0)) for n, e in effect.parameters.items()}
            result.effects[at] = FoundEffect(effect.kind, joint, parameters)


def _wider(e: Estimate, more: float) -> Estimate:
    return replace(e, std=float(np.hypot(e.std, more)))
