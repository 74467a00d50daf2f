"""The smallest payload, wrong mass of a link and tilt that these recordings would have shown.

A body of some size is implanted in the Gram matrices of the search for bodies: its torque along the
measured motion is taken out of the innovations of the final model. Then it is estimated, beside the
friction, constants and rotors of every joint, from the recordings of the fit. It is seen if, with
nine chances in ten, the recordings to choose by have the evidence that the search asks for, and if
it is larger than what stays unexplained at the joints that bear it. Otherwise it is made larger.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.decide_bodies import LARGER_THAN_LEFT, BodyClaim
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.measure.discrepancy import NINE_IN_TEN
from zendsp.diagnosis.search.body_columns import NUISANCE, Layout, Sums
from zendsp.diagnosis.search.body_explain import Explained
from zendsp.diagnosis.search.body_hypotheses import COM, LIMITS, Hypothesis, hypotheses
from zendsp.diagnosis.search.body_numbers import known_by, many, weights_of
from zendsp.diagnosis.search.body_solver import Solver
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

OFF_CENTRE = 0.1  # m from its link's centre, along each axis: places of payloads; the worst counts
ONE_MILLI = 1e-3  # kg or rad: torques of tilts are linear in angles up to here
STEEPEST = 0.2  # rad: a base that leans farther is no small fault
LARGER_ONES = 12  # of growing size, until one is seen
GROWTH = 1.25  # of the size from one implant to the next, at least
FARTHEST = 4.0  # and at most
KG, RAD = "kg", "rad"


@dataclass(frozen=True)
class _Place:
    """A hypothesis, and numbers of it for a size of 1 (kg or rad)."""

    hypothesis: Hypothesis
    unit: Array
    most: float  # a larger size is not stated
    fewer: Hypothesis | None = None  # what it is taken for where mass and centre cannot be told

    def values(self, size: float) -> Array:
        """The numbers for a size: a payload's centre stays."""
        fixed = np.array([key in COM for key in self.hypothesis.free])
        return np.where(fixed, self.unit, size * self.unit)


def detectable_bodies(
    parts: Parts,
    model: Model,
    decisions: Sequence[Decision],
    claims: Sequence[BodyClaim],
    jobs: int,
) -> tuple[Detectable, ...]:
    """The smallest bodies that would have been found.

    Parameters
    ----------
    parts : Parts
        Recordings to fit to and to choose by.
    model : Model
        The final one of the whole machine.
    decisions : sequence of Decision
        With the torque that stays unexplained, one a joint.
    claims : sequence of BodyClaim
        The bodies that were found, which are not asked for.

    Returns
    -------
    tuple of Detectable
        A payload for each link at the end of a chain, a mass for each link, a tilt.
    """
    links = parts.fit.records[0][0].links
    if links is None or all(b.parent < 0 for b in links.bodies):
        return ()
    layout = Layout(model, links)
    have = {(c.found.term.effect, c.found.term.joint) for c in claims}
    sought = [
        group
        for group in _sought(model, layout)
        if (group[0].hypothesis.effect, max(group[0].hypothesis.joint, 1)) not in have
    ]
    if not sought:
        return ()
    about = [place.hypothesis for group in sought for place in group]
    fit, choose = (
        Sums(data, model, LIMITS, jobs, about=about) for data in (parts.fit, parts.choose)
    )
    left = np.array([max(d.after.value, d.after.often) for d in decisions])
    look = _Look(layout, fit, choose, parts, left)
    return tuple(s for group in sought if (s := look.smallest(group)) is not None)


def _sought(model: Model, layout: Layout) -> Iterator[list[_Place]]:
    """The places of each body that is asked for; the worst of a body's counts."""
    bodies = layout.links.bodies
    ends = {k for k in range(len(bodies)) if all(b.parent != k for b in bodies)}
    for h in hypotheses(model, layout.links):
        link = bodies[h.joint - 1]
        if h.effect == "payload" and h.joint - 1 in ends:
            at = dict(zip(COM, link.com.tolist(), strict=True))
            here, most = np.array([at[key] for key in h.free[1:]]), sum(b.mass for b in bodies)
            away = OFF_CENTRE * np.concatenate([np.eye(len(here)), -np.eye(len(here))])
            own = Hypothesis("body", h.joint, h.body, h.free[1:])
            fewer = own if link.mass > 0 and h.free[1:] else None
            yield [
                _Place(h, np.array([1.0, *(here + by)]), most or np.inf, fewer)
                for by in (away if len(here) else np.zeros((1, 0)))
            ]
        elif h.effect == "body" and h.free == ("mass",):
            yield [_Place(h, np.ones(1), LIMITS.own_mass * link.mass)]
        elif h.effect == "base_tilt":
            yield [_Place(h, e, STEEPEST) for e in np.eye(len(h.free))]


class _Look:
    """Bodies implanted in the recordings and sought there. ``left``: what stays unexplained at each
    joint, as a part of its RMS torque.
    """

    def __init__(self, layout: Layout, fit: Sums, choose: Sums, parts: Parts, left: Array) -> None:
        self.layout, self.fit, self.choose, self.left = layout, fit, choose, left
        self.data = parts.choose
        self.bare = Solver(fit, choose, layout)

    def smallest(self, places: Sequence[_Place]) -> Detectable | None:
        """The smallest size at the worst of some places; None where not even the largest is seen,
        or one whose torque alone is as large as all torque.
        """
        place = min(places, key=self._energy)
        h, weights = place.hypothesis, self._weights(place)
        felt = weights * np.sqrt(self._not_rubbed(place))
        size, most = self._beyond_left(felt), min(place.most, 1.0 / float(np.max(weights)))
        for _ in range(LARGER_ONES):
            if not 0.0 < size < most:
                return None
            lacking = self._short_by(place, size)
            if lacking <= 1.0:
                unit = RAD if h.effect == "base_tilt" else KG
                share = size * float(np.max(felt))
                return Detectable(max(h.joint, 1), "inertia", h.effect, size, unit, share)
            size *= min(max(lacking, GROWTH), FARTHEST)
        return None

    def _energy(self, place: _Place) -> float:
        """The energy that a place leaves in the innovations beside friction, constants and rotors,
        as a part of all that is there.
        """
        return float(np.sum(self.bare.counts * self._remains(place)))

    def _remains(self, place: _Place) -> Array:
        """The same at each joint, (joints,)."""
        x = self.layout.place(place.hypothesis, place.unit)[:, NUISANCE:]
        rest = self.bare.rest
        left = np.einsum("ja,jab,jb->j", x, rest[:, :-1, :-1], x)
        return np.asarray(left / np.maximum(rest[:, -1, -1], 1e-300))

    def _weights(self, place: _Place) -> Array:
        """The torque of a size of 1 at each joint as a part of the joint's RMS torque, (joints,).
        """
        little = place.values(ONE_MILLI)
        weights = weights_of(self.data, self.layout, place.hypothesis, little) / ONE_MILLI
        return np.maximum(np.asarray(weights), 1e-300)

    def _not_rubbed(self, place: _Place) -> Array:
        """The part of that torque's square that friction, constant and rotor of each joint leave,
        (joints,).
        """
        x = self.layout.place(place.hypothesis, place.unit)
        whole = self.fit.whole[:, :-1, :-1]
        all_of_it = np.einsum("ja,jab,jb->j", x, whole, x)
        x = x[:, NUISANCE:]
        left = np.einsum("ja,jab,jb->j", x, self.bare.rest[:, :-1, :-1], x)
        part = np.where(all_of_it > 0.0, left / np.maximum(all_of_it, 1e-300), 0.0)
        return np.asarray(np.clip(part, 0.0, 1.0))

    def _beyond_left(self, felt: Array) -> float:
        """The least size with which most of the torque acts where it exceeds what is left, and the
        largest part of some joint's torque suffices for the search.
        """
        needs = np.where(felt > 0.0, self.left / np.maximum(felt, 1e-300), np.inf)
        order = np.argsort(needs)
        borne = np.cumsum(felt[order] ** 2)
        if borne[-1] <= 0.0:
            return np.inf
        at = order[int(np.searchsorted(borne, LARGER_THAN_LEFT * borne[-1]))]
        return max(float(needs[at]), LIMITS.least / float(np.max(felt)))

    def _short_by(self, place: _Place, size: float) -> float:
        """The factor by which a body would have to be larger (1 or less: it is seen)."""
        values = place.values(size)
        x = self.layout.place(place.hypothesis, values)
        fit, choose = self.fit.with_torque(x), self.choose.with_torque(x)
        both = fit.with_more(choose)
        one, all_of_it = Solver(fit, choose, self.layout), Solver(both, both, self.layout)
        shown, best = _shown(one, all_of_it, place.hypothesis, values)
        if place.fewer is not None:
            other, found = _shown(one, all_of_it, place.fewer, np.zeros(len(place.fewer.free)))
            shown = max(shown, other if _as_good(one, found, best) else 0.0)
        return 1.0 / max(shown, 1e-9)


def _as_good(solver: Solver, found: Array, best: Array) -> bool:
    """Whether numbers of a body predict as well as the best."""
    none, one, other = (float(solver.points(x).sum()) for x in (0.0 * best, best, found))
    return solver.better(best, found) < LIMITS.tie or other - one < LIMITS.share * (none - one)


def _shown(one: Solver, both: Solver, h: Hypothesis, start: Array) -> tuple[float, Array]:
    """The evidence for a hypothesis, and how well its numbers are known, as a part of what the
    search for bodies asks for with nine chances in ten; and its coefficients of the columns.
    """
    numbers = one.estimate(h, start)
    found = one.at(h, numbers)
    nothing = np.zeros_like(found)
    z = one.better(found, nothing)
    before, after = (np.maximum(one.squares(x), 1e-300) for x in (nothing, found))
    share = np.maximum(1.0 - after / before, 0.0)
    told = Explained(h, numbers, numbers, 0.0, z, 0.0, share, share)
    told, _ = known_by(one, both, told, numbers)
    sure = np.abs(told.values) / ((many(h) + NINE_IN_TEN) * np.maximum(told.std, 1e-300))
    enough = [
        min(z / (least + NINE_IN_TEN), np.sqrt(np.max(share) / part))
        for least, part in ((LIMITS.sure, LIMITS.part), (LIMITS.clear, LIMITS.little))
    ]
    return float(min(max(enough), np.max(sure))), found
