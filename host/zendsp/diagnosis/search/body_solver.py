"""Linear fits of hypotheses to the Gram matrices, and their evidence on the recordings to choose
by.
"""

from __future__ import annotations

from collections.abc import Collection
from copy import copy
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.search.body_columns import NUISANCE, Layout, Sums, product
from zendsp.diagnosis.search.body_hypotheses import COM, LIMITS, BodyLimits, Hypothesis

Array = npt.NDArray[np.float64]

LAST_DIGITS = 1e-14  # of a joint's innovations: what is left below is the rounding of their sums


@dataclass(frozen=True)
class _Squares:
    """The sum of squares that a fit leaves at each joint, by the numbers of a hypothesis: a square
    of its coefficients, (c,), about some of them (``here``).
    """

    layout: Layout
    hypothesis: Hypothesis
    here: Array
    level: Array  # (joints,)
    slope: Array  # (joints, c), half of it
    square: Array  # (joints, c, c)

    def _from_here(self, values: Array) -> Array:
        return self.layout.coefficients(self.hypothesis, values) - self.here

    def left(self, values: Array) -> Array:
        """The sum of squares, (joints,)."""
        by = self._from_here(values)
        return np.asarray(self.level + (2.0 * self.slope + self.square @ by) @ by)

    def normal(self, values: Array, weight: Array, step: float) -> tuple[Array, Array]:
        """Normal matrix (p, p) and slope (p,) of the joints' squares times a weight each."""
        by = self._from_here(values)
        jac = self.layout.slopes(self.hypothesis, values, step)
        square = np.tensordot(weight, self.square, 1)
        slope = weight @ (self.slope + self.square @ by)
        return jac.T @ square @ jac, jac.T @ slope


class Solver:
    """Linear fits of hypotheses to the recordings of the fit, and their evidence on those to choose
    by. There friction is fitted again, for any hypothesis and for none: the numbers of the
    hypothesis, the offset and the rotor beside them are predicted.

    ``origin``: coefficients of the part of a hypothesis that the model behind the sums has already.
    ``aside``: joints (1-based) with a fault of their own, whose gain, rotor and functions of
    position are nuisance too. Without ``rotors`` the other motors' inertia is the model's.
    """

    def __init__(
        self,
        fit: Sums,
        choose: Sums,
        layout: Layout,
        limits: BodyLimits = LIMITS,
        origin: Array | None = None,
        aside: Collection[int] = (),
        rotors: bool = True,
    ) -> None:
        self.fit, self.choose, self.layout, self.limits = fit, choose, layout, limits
        self.origin = np.zeros((layout.joints, layout.width)) if origin is None else origin
        rotors = rotors and layout.rotors and limits.own
        self.aside, self.rotors = aside, rotors
        whole, n = fit.whole, NUISANCE
        # the first column is the constant's, the last one the rotor's
        free = list(range(0 if limits.own else 1, n if rotors else n - 1))
        own = list(range(layout.own, layout.width))
        more = [n - 1] if not layout.rotors else []
        outs = [free + more + own if j + 1 in aside else free for j in range(layout.joints)]
        self.complete = completed(whole, outs)
        # friction between the speeds of the fit says little beyond them, and each recording has
        # its own; a rotor, an offset and a body are the same in all
        friction = list(range(1, n - 1))
        each = [friction + own if j + 1 in aside else friction for j in range(layout.joints)]
        self.chosen = self.complete if choose is fit else again(choose.whole, each, self.complete)
        self.rest = np.swapaxes(self.complete, 1, 2) @ whole @ self.complete
        self.counts = fit.counts.sum(axis=1)
        self._squares_of: dict[Hypothesis, Array] = {}
        self._points_of: dict[bytes, Array] = {}

    def beside_gain(self, by: float) -> Solver:
        """The solver for actuators that all give a part ``by`` more than stated."""
        origin = self.origin.copy()
        origin[:, self.layout.own] -= by
        return self._from(origin)

    def beside(self, h: Hypothesis, having: Array, without: Array) -> Solver:
        """The solver for a machine that has what is between two sets of numbers of a hypothesis."""
        more = self.layout.place(h, having) - self.layout.place(h, without)
        return self._from(self.origin - more)

    def _from(self, origin: Array) -> Solver:
        other = copy(self)  # what is known of the sums is the same
        other.origin = origin
        return other

    def _full(self, x: Array, complete: Array) -> Array:
        """Coefficients (joints, width) with the best nuisance and the innovations' 1, (joints,
        width + 1).
        """
        return product(complete, _with_one(x))

    def _left(self, x: Array) -> Array:
        """The sum of squares that the fit leaves, per joint."""
        tail = _with_one(x)
        return self._beyond_rounding(np.sum(tail * product(self.rest, tail), axis=1))

    def _beyond_rounding(self, left: Array) -> Array:
        """The sum of squares per joint; less than a part of all is rounding."""
        return np.asarray(np.maximum(left, 1e-9 * self.rest[:, -1, -1]))

    def _deviance(self, left: Array) -> float:
        """The deviance of a fit, with the noise of each joint profiled out, from the sum of squares
        that it leaves at each.
        """
        used = self.counts > NUISANCE
        mean = np.maximum(left[used], 1e-300) / self.counts[used]
        return float(np.sum(self.counts[used] * np.log(mean)))

    def at(self, h: Hypothesis, values: Array) -> Array:
        """Coefficients that a hypothesis adds to the model, (joints, width)."""
        return self.layout.place(h, values) - self.origin

    def estimate(self, h: Hypothesis, start: Array | None = None) -> Array:
        """The numbers that make the innovations of all joints most likely, (p,); plausible ones,
        where any start leads to such.
        """
        begins = self._starts(h) if start is None else [start]
        ends = [self._descend(h, values) for values in begins]
        return min(ends, key=lambda end: (not self.plausible(h, end[0]), end[1]))[0]

    def _descend(self, h: Hypothesis, values: Array) -> tuple[Array, float]:
        """The result of Levenberg-Marquardt from some numbers, and its deviance."""
        squares = self._about(h, values)
        left = self._beyond_rounding(squares.left(values))
        best, damping = self._deviance(left), 1e-6
        for _ in range(30):
            normal, slope = squares.normal(values, self._weight(left), self.limits.step)
            while damping < self.limits.damped:
                trial = values - solve(normal + damping * np.diag(np.diag(normal)), slope)
                leaves = self._beyond_rounding(squares.left(trial))
                value = self._deviance(leaves)
                if value <= best:
                    break
                damping *= 10
            else:
                break
            done = best - value < self.limits.settled
            values, left, best, damping = trial, leaves, value, max(damping / 10, 1e-9)
            if done:
                break
        return values, best

    def _about(self, h: Hypothesis, values: Array) -> _Squares:
        """The sums of squares by the numbers of a hypothesis, about some of them."""
        columns = self.layout.columns(h)[:, NUISANCE:]
        across = np.swapaxes(columns, 1, 2)
        if h not in self._squares_of:
            self._squares_of[h] = across @ self.rest[:, :-1, :-1] @ columns
        tail = _with_one(self.at(h, values))
        products = product(self.rest, tail)
        return _Squares(
            self.layout,
            h,
            self.layout.coefficients(h, values),
            np.sum(tail * products, axis=1),
            product(across, products[:, :-1]),
            self._squares_of[h],
        )

    def _weight(self, left: Array) -> Array:
        """The weight of each joint's squares, from the sum that a fit leaves of them; 0 for a joint
        that stands still.
        """
        told = left > 1e-12 * float(np.max(left, initial=0.0))
        return np.where(told, self.counts / np.where(told, left, 1.0), 0.0)

    def step(self, h: Hypothesis, values: Array) -> Array:
        """The difference of the most likely numbers from these, to first order, (p,)."""
        squares = self._about(h, values)
        weight = self._weight(self._beyond_rounding(squares.left(values)))
        return -solve(*squares.normal(values, weight, self.limits.step))

    def _linear(self, h: Hypothesis, values: Array) -> tuple[Array, Array]:
        """Coefficients and their derivatives without the nuisance, (joints, columns, p)."""
        slopes = self.layout.slopes(h, values, self.limits.step)
        return self.at(h, values), self.layout.columns(h)[:, NUISANCE:] @ slopes

    def _starts(self, h: Hypothesis) -> list[Array]:
        """Start values: all zero, except for a payload, whose centre has no meaning without a mass:
        those of its first moment, and a tenth of the link's mass in the link's centre.
        """
        if h.effect != "payload":
            return [np.zeros(len(h.free))]
        at = 10 * (h.joint - 1)  # mass and first moment are linear
        weight = self.counts / np.maximum(self._left(-self.origin), 1e-300)
        part = slice(at, at + len(h.free))
        normal = np.einsum("j,jab->ab", weight, self.rest[:, part, part])
        slope = np.einsum("j,ja->a", weight, self.rest[:, part, -1])
        mass, *moment = -solve(normal + 1e-9 * np.diag(np.diag(normal)), slope)
        size = max(float(np.linalg.norm(moment)), 1e-6)
        heavy = [max(abs(float(mass)), 1e-3), *(size / distance for distance in self.limits.starts)]
        link = self.layout.links.bodies[h.joint - 1]
        far = self.limits.reach + float(np.max(np.abs(link.com)))
        inside = {"mass": 0.1 * link.mass or 1e-3, **dict(zip(COM, link.com.tolist(), strict=True))}
        starts = [[m, *np.clip(np.array(moment) / m, -far, far)] for m in heavy]
        return [np.array(s) for s in (*starts, [inside.get(key, 0.0) for key in h.free])]

    def plausible(self, h: Hypothesis, values: Array) -> bool:
        """Whether numbers are possible for a machine."""
        known = dict(zip(h.free, values.tolist(), strict=True))
        bodies = self.layout.links.bodies
        if h.effect == "payload":
            robot = sum(b.mass for b in bodies) or np.inf
            centre = dict(zip(COM, bodies[h.joint - 1].com.tolist(), strict=True))
            # a body that only slides shows no centre
            far = max((abs(known[key] - centre[key]) for key in COM if key in known), default=0.0)
            wide = 0.0 <= known.get("inertia", 0.0) < known["mass"] * self.limits.spread**2
            return bool(0.0 < known["mass"] < robot and far < self.limits.reach and wide)
        if h.effect == "body":
            far = max(abs(known.get(key, 0.0)) for key in COM)
            link, mass = bodies[h.joint - 1], abs(known.get("mass", 0.0))
            # up to three times the inertia of a link of that mass by density
            most = 3.0 * float(np.max(link.inertia)) * mass / link.mass
            return bool(
                mass < link.mass
                and far < self.limits.reach
                and abs(known.get("inertia", 0.0)) <= most
            )
        if h.effect in ("torque_gain", "gravity_scale"):
            most = self.limits.gain if h.joint or h.effect != "torque_gain" else self.limits.gains
            return bool(abs(known["ratio"]) < most)
        return all(abs(known[key]) <= np.pi for key in h.free if key.startswith("zero"))

    def std(self, h: Hypothesis, values: Array) -> Array:
        """Standard deviations from the scatter of the blocks, (p,)."""
        if not len(values):
            return np.zeros(0)
        x, jac = self._linear(h, values)
        full, weight = self._full(x, self.complete), self.counts / np.maximum(self._left(x), 1e-300)
        sense = weight[:, None, None] * (self.complete[:, :, :-1] @ jac)
        grams, (full, *sense) = _of_used(self.fit.grams, full, *np.moveaxis(sense, 2, 0))
        force = product(grams, full[:, None])
        scores = (force @ np.stack(sense, axis=2)).sum(axis=0)
        normal = over_joints(weight[:, None, None] * jac, self.rest[:, :-1, :-1] @ jac)
        inverse = np.linalg.pinv(normal, rcond=1e-12, hermitian=True)
        paired = scores[:-1].T @ scores[1:]
        # neighbours are correlated (Newey and West 1987)
        spread = scores.T @ scores + 0.5 * (paired + paired.T)
        return np.asarray(np.sqrt(np.maximum(np.diag(inverse @ spread @ inverse), 0.0)))

    def own_share(self, h: Hypothesis, values: Array) -> float:
        """The part of the information on a hypothesis's last number that remains beside the
        nuisance of all joints.
        """
        x, jac = self._linear(h, values)
        weight, column = self._weight(self._left(x)), jac[:, :, -1]
        whole = self.fit.whole[:, NUISANCE:-1, NUISANCE:-1]
        beside, alone = (
            float(np.einsum("j,ja,jab,jb->", weight, column, gram, column))
            for gram in (self.rest[:, :-1, :-1], whole)
        )
        return beside / max(alone, 1e-300)

    def squares(self, x: Array) -> Array:
        """Squared innovations on the recordings to choose by, per joint."""
        full = self._full(x, self.chosen)
        return np.asarray(np.sum(full * product(self.choose.whole, full), axis=1))

    def points(self, x: Array) -> Array:
        """Deviance of the blocks to choose by, (joints, blocks)."""
        key = x.tobytes()
        if key not in self._points_of:
            self._points_of[key] = self._points(x)
        return self._points_of[key]

    def _points(self, x: Array) -> Array:
        full = self._full(x, self.chosen)
        grams, (full,) = _of_used(self.choose.grams, full)
        left = np.maximum(product(product(grams, full[:, None]), full), 0.0)
        counts = self.choose.counts
        mean = left.sum(axis=1) / np.maximum(counts.sum(axis=1), 1.0)
        mean = np.maximum(mean, 1e-300)[:, None]
        return np.asarray(
            np.where(
                counts.sum(axis=1)[:, None] > NUISANCE, left / mean + counts * np.log(mean), 0.0
            )
        )

    def better(self, x: Array, other: Array) -> float:
        """Standard deviations by which x predicts the recordings to choose by better than another.

        The larger of two measures. First, the mean gain of a block over its spread; it stays small
        where blocks differ in motion. Second, the best mix of both predictions (0: x alone, 1: the
        other; at a half they are as good), over the blocks' disagreement about it; it stays small
        where both lack something. With few informative blocks the spread is poorly known, and the
        ratio is Student's.
        """
        full = self._full(x, self.chosen)
        apart = self._full(other, self.chosen) - full
        grams, (full, apart) = _of_used(self.choose.grams, full, apart)
        force = product(grams, apart[:, None])
        energy = self.choose.whole[:, -1, -1]
        least = np.where(energy > 0.0, LAST_DIGITS * energy, np.inf)
        weight = self.choose.counts.sum(axis=1) / np.maximum(self.squares(x), least)
        squares, slope = (weight @ product(force, x) for x in (apart, full))
        whole = float(squares.sum())
        if whole <= 0.0:
            return 0.0
        mix = -float(slope.sum()) / whole
        error = spread(slope + mix * squares, self.choose.alike) / whole
        gain = (self.points(other) - self.points(x)).sum(axis=0)
        return max(
            normal((0.5 - mix) / max(error, 1e-9), whole**2 / float(squares @ squares)),
            float(gain.sum()) / max(spread(gain - gain.mean(), 1), 1e-9),
        )


def _with_one(x: Array) -> Array:
    """Coefficients without the nuisance's, and the innovations' 1, (joints, columns + 1)."""
    return np.concatenate([x[:, NUISANCE:], np.ones((len(x), 1))], axis=1)


def _of_used(grams: Array, *coefficients: Array) -> tuple[Array, list[Array]]:
    """Gram matrices, and some coefficients, (joints, columns) each, of the columns that any of
    these uses: of some 90 a hypothesis has 10 beside the nuisance's.
    """
    used = np.flatnonzero(np.any(coefficients, axis=(0, 1)))
    return grams[..., used[:, None], used], [c[:, used] for c in coefficients]


def completed(whole: Array, outs: list[list[int]]) -> Array:
    """Matrices that add to coefficients, and the innovations' 1, those of the nuisance that leave
    least, (joints, width + 1, width + 1 - NUISANCE). ``whole``: Gram matrices; ``outs``: the
    nuisance columns of each joint.
    """
    width = whole.shape[1]
    out = np.zeros((len(whole), width, width - NUISANCE))
    out[:, NUISANCE:] = np.eye(width - NUISANCE)
    for j, g in enumerate(whole):
        out[j, outs[j]] -= solve(g[np.ix_(outs[j], outs[j])], g[outs[j], NUISANCE:])
    return out


def again(whole: Array, outs: list[list[int]], complete: Array) -> Array:
    """Such matrices with some of the nuisance columns (``outs``, of each joint) fitted again to
    other recordings, and the others as they are.
    """
    out = complete.copy()
    for j, g in enumerate(whole):
        own, keep = outs[j], [k for k in range(len(g)) if k not in outs[j]]
        out[j, own] = -solve(g[np.ix_(own, own)], g[np.ix_(own, keep)] @ out[j, keep])
    return out


def over_joints(one: Array, other: Array) -> Array:
    """The sum over the joints of products of their matrices (joints, a, p) and (joints, a, ...)."""
    return np.asarray(np.tensordot(one, other, ((0, 1), (0, 1))))


def normal(t: float, blocks: float) -> float:
    """A Student ratio from this many blocks, converted to standard deviations of a normal one (at
    most 37, a probability of 1e-300).
    """
    from scipy.special import ndtri, stdtr  # takes a third of a second

    tail = max(float(stdtr(max(blocks - 1.0, 0.1), -abs(t))), 1e-300)
    return float(np.copysign(ndtri(tail), t))


def spread(scores: Array, alike: int) -> float:
    """Standard deviation of a sum over blocks with correlated neighbours (Newey and West 1987);
    infinite for fewer than four.
    """
    n, lags = len(scores), min(alike, len(scores) - 1)
    if n < 4:
        return float("inf")
    variance = whole = float(scores @ scores)
    for lag in range(1, lags + 1):
        variance += 2.0 * (1.0 - lag / (lags + 1)) * float(scores[:-lag] @ scores[lag:])
    return float(np.sqrt(max(variance, 1e-12 * whole) * n / (n - lags)))


def solve(a: Array, b: Array) -> Array:
    """Solution of a symmetric system, scaled by its diagonal; undetermined components are 0."""
    unit = np.sqrt(np.maximum(np.diag(a), 0.0))
    unit = np.where(unit > 0, unit, 1.0)
    scaled = (b.T / unit).T
    if not (np.isfinite(a).all() and np.isfinite(scaled).all()):
        return np.zeros(b.shape)  # not finite: no step
    return np.asarray(
        (np.linalg.lstsq(a / np.outer(unit, unit), scaled, rcond=1e-10)[0].T / unit).T
    )
