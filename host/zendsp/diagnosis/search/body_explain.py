"""Fitted hypotheses in order: which explains best what all joints leave, and which are as good."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.search.body_hypotheses import LIMITS, BodyLimits, Hypothesis, turned_joints
from zendsp.diagnosis.search.body_solver import Solver

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Explained:
    """A hypothesis after its linear fit.

    Attributes
    ----------
    hypothesis : Hypothesis
    values : ndarray, shape (p,)
        Numbers of ``hypothesis.free``.
    std : ndarray, shape (p,)
        Standard deviations, from the scatter of the blocks.
    gain : float
        Deviance over ``nothing`` on the recordings that choose.
    z : float
        Standard deviations by which it predicts better than ``nothing`` there.
    behind : float
        Standard deviations by which the best explanation predicts better; 0 for the best.
    joints : ndarray, shape (joints,)
        The gain by joints.
    share : ndarray, shape (joints,)
        The part of the squared innovations left by ``nothing`` that it removes at each joint.
    of_gain : ndarray, shape (p,), or None
        The part of the standard deviations that comes from the gains of the drives, where known.
    of_inertia : ndarray, shape (p,), or None
        The part that comes from an inertia that a payload may have of its own, where known.
    """

    hypothesis: Hypothesis
    values: Array
    std: Array
    gain: float
    z: float
    behind: float
    joints: Array
    share: Array
    of_gain: Array | None = None
    of_inertia: Array | None = None

    def __repr__(self) -> str:
        numbers = ", ".join(
            f"{n} = {v:.4g} ± {s:.2g}"
            for n, v, s in zip(self.hypothesis.free, self.values, self.std, strict=True)
        )
        return (
            f"<{self.hypothesis.name}: {numbers}; gain {self.gain:.0f}, z = {self.z:.1f}, behind"
            f" {self.behind:.1f}>"
        )


def explain(solver: Solver, tried: Sequence[Hypothesis], rigid: Solver) -> list[Explained]:
    """All hypotheses after their linear fits, the best first.

    Those that predict as well as the best are ordered by their cost, in log-likelihood; it includes
    a rotor that they also need and how far they fall behind. Ties are ordered by what they explain
    with the model's rotors (``rigid``): a weight at one joint with a rotor of its own imitates any
    body there. All others are ordered by gain.
    """
    nothing = solver.at(Hypothesis("nothing"), np.zeros(0))
    none, before = solver.points(nothing), solver.squares(nothing)
    before = np.where(before > 0, before, np.inf)
    out = []
    for h in tried:
        values = solver.estimate(h)
        if not solver.plausible(h, values):
            continue
        std = solver.std(h, values)
        turned = slice(len(turned_joints(h)))
        if h.effect == "zero" and not np.any(
            np.abs(values[turned]) > solver.limits.sure * std[turned]
        ):  # what it explains is the calibration beside it
            continue
        x = solver.at(h, values)
        gain = (none - solver.points(x)).sum(axis=1)
        share = np.where(np.isfinite(before), 1.0 - solver.squares(x) / before, 0.0)
        out.append(
            Explained(
                h,
                values,
                std,
                float(gain.sum()),
                solver.better(x, nothing),
                0.0,
                gain,
                share,
            )
        )
    sure = [e for e in out if seen(e, solver.limits)]
    top = max(sure or out, key=lambda e: e.gain)
    best = solver.at(top.hypothesis, top.values)
    out = [
        (
            e
            if e is top
            else replace(e, behind=solver.better(best, solver.at(e.hypothesis, e.values)))
        )
        for e in out
    ]
    # one not surely better than nothing does not tie with one that is
    ties = [
        e
        for e in out
        if tied(e, top, solver.limits) and (not sure or seen(e, solver.limits))
    ]
    stiff = {id(e): float(none.sum()) - deviance_of(e.hypothesis, rigid) for e in ties}
    short = {id(e): stiff[id(e)] < (1.0 - solver.limits.share) * e.gain for e in ties}
    most = solver.limits.tie  # farther behind, though as good by its gain
    cost = {
        id(e): price_of(e, solver) + short[id(e)] + 0.5 * min(e.behind, most) ** 2 for e in ties
    }
    ties.sort(key=lambda e: (round(cost[id(e)]), -stiff[id(e)]))
    first = first_of(ties, solver.limits)
    ties.sort(key=lambda e: e is not first)
    others = sorted((e for e in out if not any(e is t for t in ties)), key=lambda e: -e.gain)
    return ties + others


def deviance_of(h: Hypothesis, solver: Solver) -> float:
    """The deviance of the recordings to choose by, with the most likely numbers of a hypothesis."""
    return float(solver.points(solver.at(h, solver.estimate(h))).sum())


def first_of(ties: Sequence[Explained], limits: BodyLimits) -> Explained:
    """The first of some ties; or one with other numbers of the same link that predicts better, if
    any of its numbers is determined.
    """
    first = ties[0].hypothesis
    near = (
        e
        for e in ties
        if (e.hypothesis.effect, e.hypothesis.joint) == (first.effect, first.joint)
        and first.of_bodies
        and e.behind < limits.same_link
        and np.any(np.abs(e.values) >= e.std)
    )
    return next(near, ties[0])


def seen(e: Explained, limits: BodyLimits = LIMITS) -> bool:
    """Whether an explanation holds on the recordings to choose by, and is a large part of what some
    joint leaves there.
    """
    return e.z > limits.sure and float(e.share.max()) > limits.part


def clear(e: Explained, limits: BodyLimits = LIMITS) -> bool:
    """Whether an explanation that is a small part of what the joints leave is sure enough to be
    proposed.
    """
    return e.z > limits.clear and float(e.share.max()) > limits.little


def price_of(e: Explained, solver: Solver) -> float:
    """The cost of an explanation, in log-likelihood; 0 where free parameters of the model explain
    it by a small change.
    """
    if e.hypothesis.effect == "calibration":
        layout, limits = solver.layout, solver.limits
        usual = np.maximum(limits.calibrated * np.abs(layout.given), limits.far * layout.given_std)
        if np.all(np.abs(e.values) < usual):
            return 0.0
    return e.hypothesis.cost


def tied(other: Explained, top: Explained, limits: BodyLimits = LIMITS) -> bool:
    """Whether an explanation predicts as well as the best one. A common gain follows the command
    exactly, a body's torque only the measured motion, so a body may fall behind a gain by more.
    """
    h = top.hypothesis
    everywhere = h.effect == "torque_gain" and not h.joint
    share = limits.blunt if everywhere and other.hypothesis.of_bodies else limits.share
    return other.behind < limits.tie or top.gain - other.gain < share * abs(top.gain)
