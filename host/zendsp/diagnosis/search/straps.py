"""A force between two links, whatever its law: a hose, a strap, a spring.

It has a potential that depends on where the joints between its ends stand, and pulls at each of
them with that potential's slope: one function for several joints. Here it is a polynomial of the
positions of neighbouring joints. The weight of a body is such a potential too, with few numbers
and an inertia that belongs to it. So where a free potential surely predicts better, no body is
missing.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.search.body_columns import Layout, Sums
from zendsp.diagnosis.search.body_hypotheses import BodyLimits, Hypothesis
from zendsp.diagnosis.search.body_solver import Solver, spread
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.joint import JointRecord

Array = npt.NDArray[np.float64]
# degree of the polynomials: with the third a hose over joints that move by 120 degrees is predicted
# half as well, with the fifth recordings of 14 s determine no numbers
POLYNOMIAL = 4
SPAN = 3  # neighbouring joints of one potential. Chosen: a strap over four is seen at three of them
# parts of the blocks that are predicted by all the others, and blocks in a row of one part. So
# judged, 11 hoses are 8 to 17 standard deviations better than the best body, and 9 bodies 4 to 13
# better than the best hose
FOLDS, IN_A_ROW = 4, 4


class Potentials(Layout):
    """The columns of all hypotheses, and after them those of the potentials of neighbouring joints.
    """

    def __init__(self, layout: Layout, data: Data) -> None:
        super().__init__(layout.model, layout.links)
        q = [
            np.concatenate([rec[j].motion.states[0] for rec in data.records])
            for j in range(self.joints)
        ]
        self._middle = np.array([[0.5 * (x.max() + x.min())] for x in q])
        self._half = np.array([[max(0.5 * float(np.ptp(x)), 1e-9)] for x in q])
        span = min(SPAN, self.joints)
        every = product(range(POLYNOMIAL + 1), repeat=span)
        some = [p for p in every if 0 < sum(p) <= POLYNOMIAL]
        last = self.joints - span
        each = [[(0,) * a + p + (0,) * (last - a) for p in some] for a in range(last + 1)]
        self._powers = list(dict.fromkeys(p for window in each for p in window))
        at = {p: f"{self.width + k}" for k, p in enumerate(self._powers)}
        self.tried = [_strap([at[p] for p in window]) for window in each]
        # of each joint by itself
        self.alone = _strap([key for p, key in at.items() if sum(k > 0 for k in p) == 1])
        self.width += len(self._powers)

    def _put(self, x: Array, h: Hypothesis, values: Array) -> None:
        """As ``Layout`` does; a potential's numbers are those of its own columns."""
        if h.effect == "strap":
            x[:, [int(key) for key in h.free]] = values
        else:
            super()._put(x, h, values)

    def torques(self, record: JointRecord) -> Array:
        """The slope of each monomial along a joint's position, (columns, n)."""
        j = record.joint - 1
        q = (record.others[:, 0] - self._middle) / self._half
        out = np.zeros((len(self._powers), record.n))
        for row, powers in zip(out, self._powers, strict=True):
            if powers[j]:
                row[:] = powers[j] / self._half[j]
                for i, k in enumerate(powers):
                    row *= q[i] ** (k - 1 if i == j else k)
        return out


def _strap(free: Sequence[str]) -> Hypothesis:
    return Hypothesis("strap", 0, "", tuple(free))


@dataclass(frozen=True)
class Strap:
    """A force between links. ``joints``: from 1, those at which it pulls; ``z``: the standard
    deviations by which it predicts better than its nearest rival.
    """

    joints: tuple[int, ...]
    z: float


def strap_in_place_of(
    bodies: Sequence[Hypothesis],
    data: tuple[Data, Data],
    layout: Layout,
    limits: BodyLimits,
    jobs: int,
    aside: Collection[int] = (),
    alone: bool = False,
) -> Strap | None:
    """The force between links that surely predicts the torque that the joints leave better than
    each of some bodies; None where there is no such force.

    Both are fitted to three quarters of all blocks and judged on the rest, four times. A polynomial
    says nothing beyond the positions that it was fitted to, and recordings differ in these.

    Parameters
    ----------
    data : tuple of Data
        To fit to, and to choose by.
    aside : collection of int
        Joints (1-based) with a fault of their own.
    alone : bool
        Whether it has to predict better than functions of each joint's own position, too.
    """
    wide = Potentials(layout, data[0])
    fit, choose = (
        Sums(part, layout.model, limits, jobs, more=wide.torques, about=bodies) for part in data
    )
    blocks = fit.with_more(choose)
    turn = np.arange(blocks.counts.shape[1]) // IN_A_ROW % FOLDS
    rivals = (*bodies, *((wide.alone,) if alone else ()))
    every = (*rivals, *wide.tried)
    gains: list[list[Array]] = [[] for _ in every]
    for k in range(FOLDS):
        solver = Solver(
            blocks.some(turn != k), blocks.some(turn == k), wide, limits, aside=aside
        )
        none = solver.points(solver.at(Hypothesis("nothing"), np.zeros(0)))
        for gain, h in zip(gains, every, strict=True):
            gain.append(none - solver.points(solver.at(h, solver.estimate(h))))
    won = [np.concatenate(gain, axis=1) for gain in gains]  # (joints, blocks)
    best = max(won[len(rivals) :], key=np.sum)
    z = min(_ahead((best - rival).sum(axis=0), blocks.alike) for rival in won[: len(rivals)])
    at = best.sum(axis=1)
    joints = tuple(int(j) + 1 for j in np.flatnonzero(at > limits.share * at.sum()))
    return Strap(joints, z) if z > limits.tie and len(joints) > 1 else None


def _ahead(more: Array, alike: int) -> float:
    """A sum of gains over blocks, in standard deviations; ``alike`` neighbours are correlated."""
    return float(more.sum()) / max(spread(more - more.mean(), alike), 1e-9)
