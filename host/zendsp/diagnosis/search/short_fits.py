"""Short fits of one hypothesis upon a model: from each of its starts, to thinned recordings or to
all samples, under the observer that shows it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.measure.discrepancy import runs_away
from zendsp.diagnosis.measure.likelihood import (
    Scored,
    cost_of,
    deviance,
    informative,
    tune_bandwidth,
)
from zendsp.diagnosis.search.candidates import first_look
from zendsp.diagnosis.search.hypothesis import Rival, price
from zendsp.diagnosis.search.screen import Candidate, with_candidate
from zendsp.physics.calibration.fit import Data, Fit, fit, joint_handles
from zendsp.physics.calibration.handles import Handle
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model

# relative gain of a step below which a first fit ends: in a narrow valley the first step gains
# little, and 1 % is a deviance of 200
QUICK = 1e-4
UPON = 2  # iterations on all samples for a hypothesis that lost on thinned ones
SETTLED = 16.0  # rad/s: an observer this slow follows little of what is missing
WAIT = 40.0  # deviance beyond its price below which a step is not examined


def settled(scored: Scored, joint: int, least: float = SETTLED) -> float:
    """The bandwidth, rad/s, of a slow observer that holds a model to the motion, ``least`` or the
    next doubling of it, and at most the model's own. One slower than friction falls with the speed
    shows the instability: beside a Stribeck curve of 26 /s it ranked a wave of 1 % behind 4 others.
    """
    away, own = runs_away(scored.data, scored.model, joint), scored.data.bandwidth[joint - 1]
    while least <= away:
        least *= 2.0
    return min(least, own)


class ShortFits:
    """Short fits at one joint.

    Parameters
    ----------
    joint : int
        1-based.
    jobs : int
        Threads, for fits that all hypotheses share.
    count : int
        Number of samples that count.
    """

    def __init__(self, joint: int, jobs: int, count: int) -> None:
        self.joint, self.jobs, self.n = joint, jobs, count
        self._levels: dict[int, tuple[Scored, float, float]] = {}
        self._under_others: dict[int, tuple[Scored, Scored]] = {}

    def quick(self, current: Scored, group: list[Candidate]) -> Rival | None:
        """The best short fit from some starts, followed to slower observers. Where it gains
        nothing, the fits begin again under a slow observer, since a fast one follows the missing
        torque.
        """
        data, slow = current.data, get_effect(group[0].effect).slow
        calm, band = data, settled(current, self.joint)
        if data.bandwidth[self.joint - 1] > band:
            calm = data.at_bandwidth(self.joint, band)
        best = self._short_fits(current, group, calm if slow else data)
        begun = slow or get_effect(group[0].effect).scan is not None  # begun by simulations
        if calm is data or begun or (best and best.value < current.deviance - WAIT):
            return best
        other = self._short_fits(current, group, calm)
        return other if other and not (best and best.value <= other.value) else best

    def _short_fits(self, current: Scored, group: list[Candidate], data: Data) -> Rival | None:
        """The best short fit from some starts, at one observer's bandwidth: to thinned recordings,
        or to all samples where those mislead.
        """
        screened_for = get_effect(group[0].effect).scan is None
        whole = screened_for and self.misleads(current)
        begin = current if data is current.data else self.under(current, data)
        candidate, result, value = self._from_starts(current, group, begin, whole)
        if not math.isfinite(value):
            return None
        if data is not current.data and not get_effect(group[0].effect).slow:
            paid = self._rival(candidate, Scored(result, data, value, ())).price
            look = first_look(data, result.model, self.joint)
            joints = (self.joint,)
            gain = deviance(look, begin.model, joints) - deviance(look, result.model, joints)
            if gain < WAIT + paid:  # no gain even on the thinned recordings
                return None
        # the fit is worse than the model that it contains, or gained more on thinned recordings
        # than on all samples
        worse = screened_for and value > current.deviance + WAIT
        if worse and whole:
            candidate, result, value = self._from_starts(current, group, begin, False)
        gained = max(current.deviance - value, WAIT)
        if worse or (not whole and self.gain_of_look(current, result.model) > gained):
            result, value = self._upon_its_numbers(current, candidate, result, value)
        slow, data = data is not current.data, current.data
        if slow or value < current.deviance:
            data, value = tune_bandwidth(
                data, result.model, (self.joint,), down_only=True, known=value
            )
        return self._rival(candidate, Scored(result, data, value, (self.joint,)))

    def _from_starts(
        self, current: Scored, group: list[Candidate], begin: Scored, whole: bool
    ) -> tuple[Candidate, Fit, float]:
        """The best short fit from some starts, from given numbers and observer, to all samples or
        to thinned recordings; and its deviance under the model's own observer.
        """
        tried: list[tuple[float, Candidate, Fit]] = []
        data = begin.data
        for candidate in group:
            model = with_candidate(begin.model, candidate)
            handles = self._handles(data, model, candidate)
            look = data if whole else first_look(data, model, self.joint)
            goal = self._goal(candidate, begin, look)
            result = self._short(look, model, handles, 3 if len(group) > 1 else 6, goal=goal)
            tried.append((result.cost, candidate, result))
        _, candidate, result = min(tried, key=lambda t: t[0])
        value = deviance(current.data, result.model, (self.joint,))
        rough = get_effect(candidate.effect).rough
        paid = self._rival(candidate, Scored(result, data, value, ())).price
        if len(group) > 1 and (value + paid < current.deviance or rough):
            here = current.data
            look = here if whole else first_look(here, result.model, self.joint)
            result = self._short(look, result.model, result.handles, 10 if rough else 5)
            value = deviance(here, result.model, (self.joint,))
        return candidate, result, value

    def _handles(self, data: Data, model: Model, candidate: Candidate) -> list[Handle]:
        """All numbers that the joint feels, but those of a gap beneath a hypothesis: while other
        numbers are far off its rough cost leads it astray, and it takes most of the time.
        """
        beneath = model.terms[: len(model.terms) - len(candidate.terms)]
        held = {k for k, t in enumerate(beneath) if get_effect(t.effect).rough}
        handles = joint_handles(data, model, self.joint)
        return [h for h in handles if h.place != "term" or h.index not in held]

    def _goal(self, candidate: Candidate, begin: Scored, look: Data) -> float:
        """The sum of squares from which on a hypothesis upon some numbers is examined. Of one that
        begins far from its own, as those of hidden states do, nothing is known.
        """
        if get_effect(candidate.effect).scan is not None or candidate.replaces:
            return math.inf
        level = begin.deviance if look is begin.data else self._looked_through(begin)[0]
        least = WAIT + price(candidate.terms, self.n)
        seen = informative(look, self.joint) / max(self.n, 1)
        return cost_of(look, self.joint, level - least * seen)

    def _upon_its_numbers(
        self, current: Scored, candidate: Candidate, result: Fit, value: float
    ) -> tuple[Fit, float]:
        """The likeliest of three fits of a hypothesis: as fitted to thinned recordings; upon the
        model's other numbers from there; and from its start values. On thinned recordings reversals
        look different, which may move numbers of dry friction far off.
        """
        best = result, value
        # a fit that does not reach the model beneath it is of no use either
        goal = cost_of(current.data, self.joint, min(value, current.deviance))
        for terms in (result.model.terms[-len(candidate.terms) :], candidate.terms):
            model = with_candidate(current.model, replace(candidate, terms=terms))
            handles = self._handles(current.data, model, candidate)
            other = self._short(current.data, model, handles, UPON, goal=goal)
            again = deviance(current.data, other.model, (self.joint,))
            best = (other, again) if again < best[1] else best
        return best

    def under(self, current: Scored, data: Data) -> Scored:
        """A model with its numbers fitted under another observer, as a start there."""
        if id(current) not in self._under_others:
            handles, joints = current.fit.handles, (self.joint,)
            found = self._short(data, current.model, handles, 6, self.jobs)
            other = Scored(found, data, deviance(data, found.model, joints), joints)
            self._under_others[id(current)] = current, other
        return self._under_others[id(current)][1]

    def misleads(self, current: Scored) -> bool:
        """Whether thinned recordings, on which reversals look different, give a model other
        numbers. A fit to these then begins with a loss, whatever it gains.

        A model that needs a fast observer lacks much: its numbers are off anyway, and thinned
        recordings show well enough which hypothesis gains most.
        """
        if current.data.bandwidth[self.joint - 1] > SETTLED:
            return False
        return self._looked_through(current)[1] > current.deviance + WAIT

    def promised(self, rival: Rival) -> float:
        """The decrease of the deviance that a short fit still promises, to first order: next to
        nothing at a minimum. (A Stribeck curve ended 60 000 short of it, behind an offset that
        gained twice as much by then; it promised 12 000, and of ten other laws none more than 200.)
        """
        found = rival.scored.fit
        slope = found.jacobian[:, ~np.array(found.at_bound, dtype=bool)]
        if not slope.size or not np.isfinite(slope).all():
            return 0.0
        size = np.linalg.norm(slope, axis=0)
        slope = slope[:, size > 0.0] / size[size > 0.0]
        toward = np.linalg.lstsq(slope.T @ slope, slope.T @ found.residual, rcond=None)[0]
        share = float(toward @ (slope.T @ found.residual)) / max(found.cost, 1e-300)
        return -self.n * math.log1p(-min(max(share, 0.0), 1.0 - 1e-9))

    def gain_of_look(self, current: Scored, model: Model) -> float:
        """The deviance that a model gains over another on the thinned recordings of a first fit;
        the other is fitted to them too.
        """
        look = first_look(current.data, current.model, self.joint)
        return self._looked_through(current)[0] - deviance(look, model, (self.joint,))

    def _looked_through(self, current: Scored) -> tuple[float, float]:
        """The deviance of a model fitted to its thinned recordings: there, and on all samples."""
        if id(current) not in self._levels:
            joints = (self.joint,)
            look = first_look(current.data, current.model, self.joint)
            base = self._short(look, current.model, current.fit.handles, 6, self.jobs).model
            seen = deviance(look, base, joints), deviance(current.data, base, joints)
            self._levels[id(current)] = (current, *seen)
        return self._levels[id(current)][1:]

    def _short(
        self, data: Data, model: Model, handles: Sequence[Handle], rounds: int, jobs: int = 1,
        goal: float = math.inf,
    ) -> Fit:
        return fit(
            data, model, handles, joints=(self.joint,), iterations=rounds, tolerance=QUICK,
            jobs=jobs, brief=True, goal=goal,
        )  # fmt: skip

    def _rival(self, candidate: Candidate, scored: Scored) -> Rival:
        other_law = candidate.replaces and candidate.effect not in candidate.replaces
        return Rival(
            candidate.effect,
            self.joint,
            scored,
            price(candidate.terms, self.n, (candidate.effect,) if other_law else ()),
            candidate.terms,
            candidate.replaces,
        )
