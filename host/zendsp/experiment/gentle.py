"""A gentle first motion of a joint: before it moves any farther it shows whether its loop moves it
and holds the others, and what it turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import ceil

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.series import stretches
from zendsp.errors import Unmeasured
from zendsp.experiment.demand import Felt, felt
from zendsp.experiment.estimates import bump_means, smoothed
from zendsp.experiment.lab import Bench, playing
from zendsp.experiment.sliding import ACTS, Sliding, held_turns
from zendsp.experiment.watch import BEARS, LOOP, STIFFER, AtLimit, firmer
from zendsp.recording import Recording
from zendsp.reference import Reference
from zendsp_protocol.messages import JointInfo

Array = npt.NDArray[np.float64]

PROGRAM = "joint_pd.c"
CHANNELS = ("play_time", "q", "tau")
TRAVEL = 0.8  # rad or m, of the moves that follow, at most …
SHARE = 0.4  # … and of the range of the joint
SPEED = 0.4  # of the largest speed
GENTLE = 3  # cycles of the first motion, over a quarter of the way …
CALM = 2.0  # s, each move of it, at least …
SLOWEST = 16.0  # … and at most
EASY = 0.1  # of the largest speed, at most: friction that holds a joint up lets it go faster
LONGEST = 50.0  # s, all moves of a motion: a table holds 60 s
FOLLOWS = 0.8  # of what it is to do a joint does, at least; else its loop is made stiffer …
TRIES = 4  # … so often
REST = 0.3  # s, after each move
PEAK = 1.875  # largest speed of a move of length and duration 1 …
TURN = 5.774  # … and its largest acceleration
TORQUE = 0.3  # of the largest torque, to accelerate
SLIDES = 0.2  # of a move's largest speed: below, bristles bend
PIECES = 10  # of a move
WIDTH = 1.0 / 6.0  # of a move: what a piece averages over
FEWEST = 41  # samples of it
# squares of the encoder's noise over those of all else, in the longest pieces; in the shortest, a
# sixth as long, they are 8000 times as much
NOISE = (0.0, *np.geomspace(1e-4, 100.0, 19))
ROWS = 50000  # of a program's table, at most


@dataclass(frozen=True)
class Moves:
    """A reference, and the first and last row of each of its moves."""

    reference: Reference
    rows: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Accelerated(Sliding):
    """Pieces of moves that accelerate.

    Attributes
    ----------
    sure : ndarray
        Weight of each piece.
    """

    sure: Array = field(default_factory=lambda: np.zeros(0))

    def alike(self) -> Sliding:
        """The pieces as if they were equally sure."""
        return replace(self, sure=np.ones_like(self.torque), planned=())

    def weights(self) -> Array:
        """Those of `surer`."""
        return self.sure


def gentle_first(
    bench: Bench, joint: int, place: Array, middle: float, travel: float
) -> tuple[Array, Felt]:
    """Move a joint gently about the ``middle`` of the ``travel`` that is to follow. Where it does
    not follow, or a held joint gives way, the loop is made stiffer and the motion repeated.

    Returns
    -------
    ndarray
        Inertia of each joint that joint_pd.c is to take, kg m^2 or kg.
    Felt
        What the motion shows of the joint itself.

    Raises
    ------
    Unmeasured
        It does not follow, or a held joint gives way so far that the larger motion would take it
        too far.
    """
    told, rate = bench.machine.joints, bench.target.status().rate_hz
    own = told[joint - 1]
    each = _calm(own, travel / 4.0, declared(bench)[joint - 1])
    way = each[-1][1]

    def moved(longer: float = 1.0, **values: Array) -> tuple[Recording, Moves]:
        durations, ways = zip(*((longer * seconds, way) for seconds, way in each), strict=True)
        moves = smooth_moves(place, joint, middle - way / 2.0, ways, durations, 1.0 / rate)
        try:
            return bench.record(
                f"joint{joint}_gentle", PROGRAM, CHANNELS, reference=moves.reference,
                before=approach_time(bench), **values,  # type: ignore[arg-type]
            ), moves
        except AtLimit:  # one that goes may need less to go at half of that pace
            if bench.seen[joint].way < FOLLOWS * way or 2.0 * moves.reference.duration > LONGEST:
                raise
        return moved(2.0 * longer, **values)

    rec, moves = moved()
    inertias = np.atleast_1d(np.asarray(rec.parameters["J"], dtype=np.float64)).copy()
    tries = 0
    while (went := _followed(rec, joint)) < FOLLOWS * way:
        if tries == TRIES:
            raise Unmeasured(
                f"{own.name}: does not follow its loop, of {way:.3g} {own.unit} it moves"
                f" {went:.3g}: let the machine declare a larger inertia of the joint"
            )
        tries += 1  # a light joint with much friction hardly gives way to its loop
        inertias[joint - 1] *= STIFFER
        rec, moves = moved(J=inertias)
    while firm := firmer(bench.seen, joint, told, rate, inertias / bench.inertias):
        inertias[[j - 1 for j in firm]] *= STIFFER
        rec, moves = moved(J=inertias)
    found = _felt(rec, moves, joint, float(inertias[joint - 1]))
    # a friction that depends on the place may look like an inertia: the sampling has to bear the
    # loop at the declared one, too
    borne = BEARS * rate / LOOP * bench.inertias[joint - 1]
    inertias[joint - 1] = max(inertias[joint - 1], min(found.inertia, borne))
    return inertias, found


def _felt(rec: Recording, moves: Moves, joint: int, said: float) -> Felt:
    """What a gentle motion shows of a joint; ``said``: the inertia where it does not show that."""
    tau = np.atleast_2d(rec["tau"].T).T[playing(rec, moves.reference.samples), joint - 1]
    noise = float(np.std(tau - smoothed(tau, FEWEST)))
    return felt(weak_pieces(rec, moves, joint), said, noise)


def _calm(own: JointInfo, way: float, inertia: float) -> list[tuple[float, float]]:
    """Time and way of each cycle of a gentle motion, at up to a tenth of the joint's speed. One
    that is so slow goes a shorter way first, and then once the way that is wanted, or as far as it
    comes in ``SLOWEST``: a small part of a way does not tell the weight at its ends.
    """
    pace = EASY * own.speed_max / PEAK
    near = min(way, pace * CALM)
    cycles = [(max(CALM, pushed_time(own, near, inertia)), near)] * GENTLE
    if near < way:
        far = min(way, pace * SLOWEST)
        cycles.append((max(far / pace, pushed_time(own, far, inertia)), far))
    return cycles


def approach_time(bench: Bench) -> float:
    """Time in which any joint comes from wherever its moves ended to where the next ones begin at
    less than its largest speed, s.
    """
    joints = bench.machine.joints
    ways = [min(TRAVEL, SHARE * (j.position_max - j.position_min)) for j in joints]
    times = [PEAK * w / (SPEED * j.speed_max) for j, w in zip(joints, ways, strict=True)
             if j.speed_max > 0.0]  # fmt: skip
    each = zip(joints, ways, declared(bench), strict=True)
    times += [pushed_time(j, w, J) for j, w, J in each if j.command != "none"]
    return max(2.0, *(ceil(t) for t in times))


def declared(bench: Bench) -> Array:
    """Inertia of each joint as the loop takes it, kg m^2 or kg: what the machine says."""
    if not bench.inertias.size:
        bench.target.download(PROGRAM)
        bench.inertias = np.atleast_1d(np.asarray(bench.target["J"], dtype=np.float64))
    return bench.inertias


def pushed_time(own: JointInfo, way: float, inertia: float) -> float:
    """The shortest time of a smooth move that takes ``TORQUE`` to accelerate, s."""
    return float((TURN * way * inertia / (TORQUE * own.torque_max)) ** 0.5)


def _followed(rec: Recording, joint: int) -> float:
    """How far a joint moved while the reference was played."""
    q = np.atleast_2d(rec["q"].T).T[rec["play_time"] >= 0.0, joint - 1]
    return float(np.ptp(q))


def smooth_moves(
    place: Array, joint: int, start: float, travel: float | Sequence[float],
    durations: Sequence[float], period: float,
) -> Moves:
    """For each duration a move there and one back, without a jump of the acceleration, and rests;
    ``travel``: how far all go, or each.
    """
    way, rows, row = [], [], 0
    rest = round(REST / period)
    for duration, far in zip(durations, np.broadcast_to(travel, len(durations)), strict=True):
        n = round(duration / period)
        s = np.arange(n) / n
        share = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        for there in (share, 1.0 - share):
            way += [start + far * there, np.full(rest, start + far * round(there[-1]))]
            rows.append((row, row + n))
            row += n + rest
    q = np.tile(place, (row, 1))
    q[:, joint - 1] = np.concatenate(way)
    return Moves(Reference(q, period, kind="point_to_point", machine=""), tuple(rows))


def stride_of(seconds: float, period: float) -> int:
    """Samples a row of a motion that a program's table holds; rows a second are a whole number, as
    programs play them.
    """
    rate = round(1.0 / period)
    stride = max(1, int(np.ceil(seconds * rate / ROWS)))
    while stride < rate and rate % stride:
        stride += 1
    return stride


def weak_pieces(rec: Recording, moves: Moves, joint: int) -> Accelerated:
    """Means over pieces of each move, where the joint slides.

    The torque is the one that acts during the sample.
    """
    rows = playing(rec, moves.reference.samples)
    q, tau = (np.atleast_2d(rec[name].T).T[rows][:, joint - 1] for name in ("q", "tau"))
    dt = rec.sample_time
    speed = smoothed(q, FEWEST, dt, 1)
    every = np.atleast_2d(rec["q"].T).T[rows]
    others = np.delete(every, joint - 1, axis=1)
    way, gains = (x[:, joint - 1] for x in (moves.reference.q, moves.reference.qdd))
    pieces, turns = [], []
    for part, (first, last) in enumerate(moves.rows):
        last = min(last + round(REST / dt / 2), len(q))
        pace = np.abs(speed[first:last])
        runs = stretches(pace > SLIDES * pace.max())
        a, b = max(runs, key=lambda run: run[1] - run[0])
        n = max(FEWEST, round(WIDTH * (b - a)))
        for begin in np.unique(np.linspace(first + a, first + b - n, PIECES).astype(int)):
            if b - a > n and begin + n + 2 <= len(q):
                mine = slice(int(begin), int(begin) + n)
                plan = (*bump_means(gains[mine], dt)[:2], *bump_means(way[mine], dt)[:2])
                pieces.append((part, *_piece(q, tau, int(begin), n, dt), *plan, n))
                turns.append(np.array([bump_means(x, dt)[2] for x in every[mine].T]))
    if not pieces:
        raise Unmeasured(f"joint {joint}: moves too little, or too briefly, to be measured")
    columns = np.array(pieces).T
    away = float(others.std(axis=0).max(initial=0.0))
    part, at, cos, sin, pace, torque, gain, rate, wanted, turn, place, fast, long = columns
    none = np.zeros_like(torque)
    # the drive's own lag, which nothing declares, is a share of the torque's rate
    found = Accelerated(
        part.astype(np.int64), at, pace, torque, none, gain, away, (rate,),
        (wanted, turn, fast * np.cos(place), fast * np.sin(place)),
        turns=held_turns(turns, joint), turned=(cos, sin),
    )  # fmt: skip
    return replace(found, sure=surer(found, long))


def surer(pieces: Sliding, long: Array) -> Array:
    """The weight of each piece: one over its scatter, relative to that of the surest.

    What friction varies by with place is alike in all. What the encoder's noise, of a standard
    deviation s, adds to a mean acceleration over n samples is in proportion to s n^-2.5. In which
    proportion the squares of both are is what makes the scatter that is left the most likely.

    Parameters
    ----------
    pieces : Sliding
    long : ndarray
        Samples of each piece.
    """
    up = pieces.speed > 0
    friction = [up, ~up, up * pieces.speed, ~up * pieces.speed]
    # a held joint that gives way is felt most where the moves are short, as noise is
    beside = (*pieces.further, *pieces.turns.values())
    every = [*friction, *pieces.turning(), pieces.acceleration, *beside]
    A = np.stack(every, axis=1).astype(np.float64)
    best, found = np.inf, np.ones_like(pieces.torque)
    for share in NOISE:
        weight = (1.0 + share * ((long / long.max()) ** -5 - 1.0)) ** -0.5
        w = weight[:, None]
        left = weight * pieces.torque - w * A @ np.linalg.lstsq(w * A, weight * pieces.torque)[0]
        unlikely = len(left) * np.log(max(float(left @ left), 1e-300)) - 2 * np.log(weight).sum()
        if unlikely < best:
            best, found = unlikely, weight
    return found


def _piece(q: Array, tau: Array, begin: int, n: int, dt: float) -> tuple[float, ...]:
    """Position, its cosine and sine, speed, torque, acceleration, and rate of the torque, of one
    piece of n samples.
    """
    at = np.arange(begin, begin + n)
    acting = np.interp(at - ACTS, np.arange(len(tau)), tau)
    place, speed, turn = bump_means(q[at], dt)
    torque, rate, _ = bump_means(acting, dt)
    turned = (bump_means(x, dt)[0] for x in (np.cos(q[at]), np.sin(q[at])))
    return place, *turned, speed, torque, turn, rate
