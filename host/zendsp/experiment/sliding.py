"""Friction of a joint, of each direction, from pieces of motion in which it slides; beside it
weight and inertia.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.series import stretches
from zendsp.experiment.estimates import NORMAL, least_squares, smoothed, widest_of_few
from zendsp.experiment.lab import playing
from zendsp.experiment.result import Estimate, FoundEffect
from zendsp.recording import Recording
from zendsp.reference import Reference

Array = npt.NDArray[np.float64]

ACTS = 1.5  # samples after its own, on the mean: a command acts during the next one
STEADY, MOVING = 1e-6, 1e-3  # rad/s², rad/s, of a plan: its parts at constant speed
SHORTEST = 20  # rows of such a part: ten pieces of two
SMOOTHED = 41  # rows that a speed is read from, at most
QUIETEST = 0.03  # of the largest scatter: what two others differ by below is rounding


@dataclass(frozen=True)
class Sliding:
    """Means over short pieces of those parts of a joint's moves that have constant speed.

    Attributes
    ----------
    part : ndarray of int
        Which part a piece belongs to.
    q, speed, torque, gravity, acceleration : ndarray
        Position (rad), speed (rad/s), torque less the model's gravity, and that
        gravity (N m); what acceleration is left (rad/s^2).
    others : float
        By how much the others were displaced, RMS of the joint where that is most, rad.
    further : tuple of ndarray
        What else the torque may be proportional to.
    planned : tuple of ndarray
        What the plan says that the acceleration, and the first of ``further``, depend on, where
        noise is a part of what is measured of these two.
    turns : mapping of int to ndarray
        Acceleration of each joint that was to be held, rad/s^2, by its number.
    scatter : ndarray, optional
        Standard deviation of the torque within each piece, N m.
    step : float
        Of the torque, where the resolution of the command is known, N m.
    inertia : tuple of float, optional
        With its half width, where the torque is given without it, kg m^2.
    unsure : tuple of ndarray
        Standard deviations of what was taken off the torque so: in each, all pieces are off by the
        same share, N m.
    count : float
        One count of the encoder, rad (m).
    turned : tuple of ndarray, optional
        Means of the cosine and the sine of the position, where a piece is too long for those of its
        mean position: over 0.1 rad they differ by 0.04 %.
    """

    part: npt.NDArray[np.int64]
    q: Array
    speed: Array
    torque: Array
    gravity: Array
    acceleration: Array
    others: float = 0.0
    further: tuple[Array, ...] = ()
    planned: tuple[Array, ...] = ()
    scatter: Array | None = None
    step: float = 0.0
    turns: Mapping[int, Array] = field(default_factory=dict)
    inertia: tuple[float, float] | None = None
    unsure: tuple[Array, ...] = ()
    count: float = 0.0
    turned: tuple[Array, Array] | None = None

    def turning(self) -> tuple[Array, Array]:
        """Cosine and sine of the position of each piece."""
        return self.turned or (np.cos(self.q), np.sin(self.q))

    def rounded(self) -> Array:
        """Standard deviation of what the mean torque of each piece is rounded by. A command that
        scatters over steps is rounded by nothing on the mean (Widrow and Kollár 2008).
        """
        if self.scatter is None or not self.step:
            return np.zeros_like(self.torque)
        return np.asarray(
            self.step / 12**0.5 * np.exp(-2.0 * (np.pi * self.scatter / self.step) ** 2)
        )

    def points(self, friction: Array) -> Array:
        """For each part: mean speed, mean of ``friction`` and its standard error, as three rows."""
        rows = []
        for k in np.unique(self.part):
            here = friction[self.part == k]
            rows.append(
                (
                    self.speed[self.part == k].mean(),
                    here.mean(),
                    here.std(ddof=1) / len(here) ** 0.5,
                )
            )
        return np.array(rows)

    def places(self) -> npt.NDArray[np.int64]:
        """The tenth of the way in which each piece lies."""
        edges = np.linspace(self.q.min(), self.q.max(), 11)[1:-1]
        return np.digitize(self.q, edges)

    def alike(self) -> Sliding:
        """The pieces without what is known of their noise."""
        return self

    def weights(self) -> Array:
        """The weight of each piece: see `_weighed`."""
        return self._weighed

    @cached_property  # for many lines that are compared: most of each one's time
    def _weighed(self) -> Array:
        """The weight of each piece: one over the scatter of pieces of that speed, relative to the
        largest. Short fast parts scatter more than long slow ones.

        It is about a parabola along each part, and what acceleration and speed take: the loop of a
        light joint still settles where a part begins, and that is no scatter.
        """
        up, pace = self.speed > 0, np.zeros_like(self.torque)
        columns = [up * self.speed, ~up * self.speed, self.acceleration, *self.further]
        for k in np.unique(self.part):
            here = self.part == k
            pace[here] = np.round(4.0 * np.log2(np.abs(self.speed[here].mean())))
            columns += [here * x for x in np.vander(self.q - self.q[here].mean(), 3).T]
        A = np.stack(columns, axis=1)
        left = self.torque - A @ np.linalg.lstsq(A, self.torque, rcond=None)[0]
        scatter = np.ones_like(left)
        for v in np.unique(pace):
            scatter[pace == v] = np.sqrt(np.mean(left[pace == v] ** 2))
        largest = float(scatter.max())
        if not largest:
            return np.ones_like(left)
        return np.asarray(largest / np.maximum(scatter, QUIETEST * largest))


def constant_speed_pieces(
    rec: Recording, reference: Reference, joint: int, gravity: bool = True
) -> Sliding:
    """The parts of a recording at constant speed, ten pieces each. ``gravity``: the program records
    as ``g`` what it compensates.

    The first 30 % of each part are left out, in which the controller settles; so is the end, where
    a smoothed speed would take in the following ramp.
    """
    ratio = round(rec.sample_time / reference.sample_time)
    rows = playing(rec, reference.samples // ratio)
    every = np.atleast_2d(rec["q"].T).T[rows]
    q, tau = every[:, joint - 1], np.atleast_2d(rec["tau"].T).T[rows][:, joint - 1]
    # where the program compensates no weight, all of it is found beside friction
    g = rec["g"][rows][:, joint - 1] if gravity else np.zeros_like(tau)
    wanted = reference.qd[::ratio, joint - 1][: len(q)]
    steady = (np.abs(reference.qdd[::ratio, joint - 1][: len(q)]) < STEADY) & (
        np.abs(wanted) > MOVING
    )
    moves = stretches(steady)
    beside = min(SMOOTHED, min((b - a for a, b in moves), default=SMOOTHED) // 4) // 2
    window = max(3, 2 * beside + 1)
    qd, qdd = (smoothed(q, window, rec.sample_time, order) for order in (1, 2))
    # each row has the command that acts by then; the acceleration, too, changes until then
    at = np.arange(len(tau))
    acting = np.interp(at - ACTS / rec.decimation, at, tau - g)
    # the slope of a parabola is a mean of speeds; torque by the same weights, where it accelerates
    half = window // 2
    share = half * (half + 1.0) - np.arange(-half, half + 1) ** 2
    acting = np.convolve(np.pad(acting, half, "edge"), share / share.sum(), "valid")
    turns = smoothed(every, window, rec.sample_time, 2)
    pieces, others_turn = [], []
    for part, (first, last) in enumerate(moves):
        first += round(0.3 * (last - first))
        last -= beside
        if last - first < SHORTEST:
            continue
        for piece in np.array_split(np.arange(first, last), 10):
            means = (x[piece].mean() for x in (q, qd, acting, g, qdd, np.cos(q), np.sin(q)))
            pieces.append((part, *means, tau[piece].std()))
            others_turn.append(turns[piece].mean(axis=0))
    columns = np.array(pieces).T
    away = every[: len(steady)][steady]
    others = np.delete(away.std(axis=0), joint - 1).max(initial=0.0)
    found = Sliding(columns[0].astype(np.int64), *columns[1:6])
    return replace(
        found, others=float(others), scatter=columns[8], turns=held_turns(others_turn, joint),
        turned=(columns[6], columns[7]),
    )  # fmt: skip


def held_turns(turns: Sequence[Array], joint: int) -> dict[int, Array]:
    """`Sliding.turns`, from the accelerations of all joints in each piece."""
    columns = np.array(turns).T
    return {k: column for k, column in enumerate(columns, 1) if k != joint}


@dataclass(frozen=True)
class Friction:
    """Level (N m) and viscous coefficient (N m s/rad) of each direction with 95 % half widths, and
    the means of both directions; and the gravity torque that the model lacks along the way, N m.
    """

    value: dict[str, tuple[float, float, float, float]]
    mean: tuple[float, float, float, float]
    uneven: bool  # whether a direction differs from the other by more than its interval
    lacking: Array
    free: Array  # the torque without it, and without what accelerates
    weight: float  # N m, the most that the joint carries beyond what is compensated
    squares: float  # sum of the squared weighted residuals
    excess: float = 0.0  # N m more at rest, where friction falls with speed (Stribeck)
    excess_half: float = 0.0  # N m, half width of it
    slow: float = 0.0  # rad/s, at which a third of it is left
    weight_half: float = 0.0  # N m, half width of the weight
    apart_half: float = 0.0  # N m, half width of half of what the directions' levels differ by
    # with half widths: weight as sine and cosine of the position, or the same everywhere, N m;
    # inertia, kg m^2
    constant: tuple[float, float] = (0.0, 0.0)
    sine: tuple[float, float] = (0.0, 0.0)
    cosine: tuple[float, float] = (0.0, 0.0)
    inertia: tuple[float, float] = (0.0, 0.0)
    alike: bool = False  # both directions are taken as alike: nothing tells them from weight

    def weights(self, turns: bool) -> dict[str, tuple[float, float]]:
        """The weight with half widths, by name: the same everywhere, or as sine and cosine."""
        if self.constant[1] or not turns:
            return {"weight": self.constant}
        return {"weight_sine": self.sine, "weight_cosine": self.cosine}


@dataclass(frozen=True)
class _Solved:
    """A solution, its columns as they are and weighted (`_explained`), and what is left."""

    columns: Array
    others: int  # columns before those that fall with speed
    weighted: Array
    x: Array
    inverse: Array  # covariance of it over the variance of what is left
    left: Array


def _solve(
    sliding: Sliding, weighs: bool, unknown: bool, slow: float, about: bool, both: bool
) -> _Solved:
    """The numbers of `fit_friction`, without their uncertainties."""
    A, others = _columns(sliding, weighs, unknown, slow, about)
    weight = sliding.weights()
    measured, torque = weight[:, None] * A, weight * sliding.torque
    weighted = _explained(sliding, measured, 6 if weighs else 4) if unknown else measured
    shared = np.eye(A.shape[1])
    if both:
        shared[2, 0] = shared[3, 1] = 1.0
        shared = np.delete(shared, [2, 3], axis=1)
    y, _, within = least_squares(weighted @ shared, torque)
    x = shared @ y
    return _Solved(A, others, weighted, x, shared @ within @ shared.T, torque - measured @ x)


def unexplained(sliding: Sliding, weighs: bool, slow: float = 0.0) -> float:
    """Sum of squares that `fit_friction` leaves of an unknown machine's torques; infinite where
    what is to fall with speed would rise: beside a line that falls for ever it may explain as much.
    Intervals take most of a fit's time, and only the chosen one of many needs them.
    """
    solved = _solve(sliding, weighs, True, slow, False, False)
    rises = slow > 0.0 and solved.x[solved.others] <= 0.0
    return math.inf if rises else float(solved.left @ solved.left)


def fit_friction(
    sliding: Sliding,
    weighs: bool,
    unknown: bool = False,
    slow: float = 0.0,
    about: bool = False,
    both: bool = False,
) -> Friction:
    """Friction of each direction together with the gravity torque that the compensation lacks.

    Whatever a joint carries, its weight is a cos q + b sin q of the joint's own position; friction
    is not of that form. A joint that moves no weight (a vertical axis) has neither term.
    ``unknown``: nothing is known of the machine. The inertia is fitted too. Friction may vary with
    place, so the intervals are widened by what pieces of one part, or of one place, have in common.
    ``slow``: friction falls with speed below this one, rad/s; ``about``: this speed is itself
    uncertain. ``both``: friction is the same in both directions.

    The encoder's noise is in the measured acceleration, and the loop answers it with torque. Where
    there is a plan both are taken as it and the other columns explain them (two-stage least
    squares): noise is in no plan.
    """
    solved = _solve(sliding, weighs, unknown, slow, about, both)
    A, others, x, left = solved.columns, solved.others, solved.x, solved.left
    ways = np.zeros((4, len(x)))  # means of both directions, and half of what they differ by
    ways[0, [0, 2]] = ways[1, [1, 3]] = 0.5
    ways[2, [0, 2]] = ways[3, [1, 3]] = 0.5, -0.5
    apart = ways @ x
    carried = A[:, 4:6] @ x[4:6] if weighs else 0.0 * sliding.q
    most = np.zeros((1, len(x)))  # the weight where it is largest
    if weighs:
        most[0, 4:6] = A[int(np.argmax(np.abs(carried))), 4:6]
    every = np.vstack([np.eye(len(x)), ways, most])
    wide = _half_widths(sliding, solved.weighted, left, solved.inverse, every, unknown)
    half, width = np.split(wide, [len(x)])
    if unknown:  # the others give way in the direction of the move, and change that weight
        blur = NORMAL * sliding.others * float(np.hypot(*x[4:6])) if weighs else 0.0
        slope = blur / float(np.abs(sliding.speed).max())  # not alike at slow and fast moves
        half[[0, 2]], width[0] = np.hypot(half[[0, 2]], blur), np.hypot(width[0], blur)
        half[[1, 3]], width[1] = np.hypot(half[[1, 3]], slope), np.hypot(width[1], slope)
    if weighs:  # the zero of the encoder is known to half a count
        half[4:6] = np.hypot(half[4:6], NORMAL * sliding.count / 12**0.5 * np.abs(x[[5, 4]]))
    squares = float(left @ left)
    value = {
        word: (float(x[k]), float(x[k + 1]), float(half[k]), float(half[k + 1]))
        for word, k in (("+", 0), ("-", 2))
    }
    largest = float(np.abs(carried).max())
    mean = (float(apart[0]), float(apart[1]), float(width[0]), float(width[1]))
    uneven = bool(np.any(np.abs(apart[2:]) > width[2:4]))
    excess = float(x[others]) if slow else 0.0
    free = sliding.torque - A[:, 4:others] @ x[4:others]
    found = Friction(
        value, mean, uneven, carried, free, largest, squares, excess,
        excess_half=float(half[others]) if slow else 0.0, slow=slow,
        weight_half=float(width[4]), apart_half=float(width[2]), alike=both,
    )
    each = [(float(v), float(h)) for v, h in zip(x, half, strict=True)]
    if weighs:
        found = replace(found, cosine=each[4], sine=each[5])
    if not unknown:
        return found
    return replace(found, inertia=sliding.inertia or each[6 if weighs else 4])


def _half_widths(
    sliding: Sliding, A: Array, left: Array, inverse: Array, ways: Array, unknown: bool
) -> Array:
    """Half widths of combinations (rows of ``ways``) of a solution, by weighted columns ``A``."""
    each = (sliding.part, sliding.places()) if unknown else ()
    wide = widest_of_few(A, left, inverse, ways, each)
    weight = sliding.weights()
    # what a command is rounded by is the same in all of a part
    error = A * (weight * sliding.rounded())[:, None]
    sums = np.stack([error[sliding.part == k].sum(axis=0) for k in np.unique(sliding.part)], axis=1)
    for off in sliding.unsure:
        sums = np.column_stack([sums, A.T @ (weight * off)])
    return np.asarray(np.hypot(wide, NORMAL * np.linalg.norm(ways @ inverse @ sums, axis=1)))


def _explained(sliding: Sliding, A: Array, first: int) -> Array:
    """Weighted columns, of which the ``first`` and the one after it are as the plan, where there is
    one, and the others explain them.
    """
    if not sliding.planned:
        return A
    plan = sliding.weights()[:, None] * np.stack(sliding.planned, axis=1)
    Z = np.hstack([np.delete(A, [first, first + 1], axis=1), plan])
    return np.asarray(Z @ np.linalg.lstsq(Z, A, rcond=None)[0])


def _columns(
    sliding: Sliding, weighs: bool, unknown: bool, slow: float, about: bool
) -> tuple[Array, int]:
    """What the torque is a sum of: level and viscous part of each direction, weight, inertia, what
    else there is; and how many columns come before those that fall with speed.
    """
    up = sliding.speed > 0
    columns = [up, up * sliding.speed, -1.0 * ~up, ~up * sliding.speed]
    if weighs:
        columns += sliding.turning()
    if unknown and sliding.inertia is None:
        columns.append(sliding.acceleration)
    columns += sliding.further
    others = len(columns)
    if slow:
        ratio = (sliding.speed / slow) ** 2
        falls = np.sign(sliding.speed) * np.exp(-ratio)
        columns += [falls, falls * ratio] if about else [falls]
    return np.stack([np.asarray(c, dtype=np.float64) for c in columns], axis=1), others


def found_friction(joint: int, fitted: Friction) -> list[FoundEffect]:
    """A joint's friction as effects of a model: of each direction where they differ. A level or a
    coefficient that came out below zero, which no model takes, is zero.
    """
    if fitted.uneven:
        return friction_effects(joint, fitted)
    level, viscous, half_level, half_viscous = fitted.mean
    coefficient = Estimate(max(0.0, viscous), half_viscous / NORMAL)
    return [
        FoundEffect("coulomb", joint, {"level": Estimate(max(0.0, level), half_level / NORMAL)}),
        FoundEffect("viscous", joint, {"coefficient": coefficient}),
    ]


def friction_effects(joint: int, fitted: Friction) -> list[FoundEffect]:
    """A joint's friction as effects of a model, of each direction."""
    coulomb, viscous = {}, {}
    for word, end in (("+", "pos"), ("-", "neg")):
        level, slope, half_level, half_slope = fitted.value[word]
        coulomb[f"level_{end}"] = Estimate(max(0.0, level), half_level / NORMAL)
        viscous[f"coefficient_{end}"] = Estimate(max(0.0, slope), half_slope / NORMAL)
    return [
        FoundEffect("coulomb_asymmetry", joint, coulomb),
        FoundEffect("viscous_asymmetry", joint, viscous),
    ]


def cannot_separate(viscous: float, half_width: float) -> bool:
    """Whether a viscous coefficient is negative, or its 95 % interval reaches zero: these speeds
    then do not separate it from Coulomb friction.
    """
    return bool(viscous - half_width <= 0.0)
