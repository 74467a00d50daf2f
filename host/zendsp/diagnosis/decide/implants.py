"""An effect put into recordings, and judged as the decision judges a finding.

The effect is in the recordings and not in the model: calibrated numbers and observer are fitted
without it to the recordings of the fit, and the test recordings have to miss it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision, needed
from zendsp.diagnosis.decide.pieces import dependence, log_e_value
from zendsp.diagnosis.decide.thresholds import CLAIMED
from zendsp.diagnosis.measure.discrepancy import NINE_IN_TEN, difference
from zendsp.diagnosis.measure.evidence import block_scores, evidence, settling
from zendsp.diagnosis.measure.likelihood import Scored, fit_scored, informative
from zendsp.diagnosis.measure.windows import standing_out, window_error
from zendsp.diagnosis.search.hypothesis import price
from zendsp.diagnosis.search.rounds import PROMISING
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.physics.calibration.fit import Data, Fit, fit, joint_handles, residual
from zendsp.physics.calibration.handles import Handle, get_values, set_values
from zendsp.physics.effects import Effect, get_effect
from zendsp.physics.model import Model, Term

Array = npt.NDArray[np.float64]

NOT_SMALL = 0.3  # of the RMS torque: a larger effect is not looked for
ITERATIONS = 6  # of the fit without the implant
ABSORBED = 3  # sizes that calibration absorbs whole, after which no larger one is tried
IMPLANTS = 6  # of growing size, until one is seen
AMPLE = 1.05  # margin over the size that an estimate or the last implant seems to need
# times the last implant at most; and at least, where that lacks evidence. Torque and error in
# windows grow with the size (times 1.6 at most: within 5 % in 65 of 71). The gain of blocks may
# not: an implant made larger by just the factor that it lacked still lacked something in 172 of 199
FARTHER, LARGER = 10.0, 1.5
# times too small: what a fit leaves of such an implant is rounding. One that an inertia took up was
# 6111 times too small, and at the next size infinitely
NOTHING_LEFT = 100.0
NOT_SEEN = math.inf, 0.0  # size and torque of what no recording like these would show


def set_numbers(term: Term, values: dict[str, float]) -> Term:
    """A term with other values of some of its numbers."""
    numbers = {n: replace(term.parameters[n], value=v) for n, v in values.items()}
    return replace(term, parameters={**term.parameters, **numbers})


def size_of(effect: Effect) -> str:
    """Name of the parameter that is an effect's size."""
    return effect.linear[0] if effect.linear else effect.parameters[0].name


def larger(term: Term, factor: float) -> Term:
    """A term of so many times the size: of a spring the compliance, as damped as before."""
    key = size_of(get_effect(term.effect))
    if key != "stiffness" or get_effect(term.effect).family != "transmission":
        return set_numbers(term, {key: term.value(key) * factor})
    numbers = {key: term.value(key) / factor}
    return set_numbers(term, {**numbers, "damping": term.value("damping") / math.sqrt(factor)})


class Implant:
    """Effects implanted at a joint and judged as the decision judges: the effect is in the
    recordings and not in the model, whose calibrated numbers and observer are fitted to the
    recordings of the fit.
    """

    def __init__(self, parts: Parts, given: Model, decision: Decision, jobs: int) -> None:
        self.test, self.joint, self.final, self.jobs = (
            parts.test, decision.joint, decision.final, jobs
        )  # fmt: skip
        self.given = given.at(decision.joint)
        # a gain of G = |c|² s² / σ² is 2 log e in the mean, with standard deviation 2 √G
        self.root = NINE_IN_TEN + math.sqrt(NINE_IN_TEN**2 + 2.0 * needed(self.test.joints))
        self.errors = window_error(self.test, self.final.model, self.joint)
        bandwidth = self.final.data.bandwidth[self.joint - 1]
        data = self.test.at_bandwidth(self.joint, bandwidth)
        innovations = residual(data, self.final.model, (self.joint,))
        mean = float(innovations @ innovations) / max(informative(data, self.joint), 1)
        self.n = informative(self.final.data, self.joint)
        # root of the energy that an effect must leave in the innovations
        self.energy = self.root * math.sqrt(mean * dependence(self.final, self.test, self.joint))
        self._scores: dict[float, Array] = {}  # of the final model, by the share left out
        self._finals: dict[tuple[object, ...], Fit] = {}

    def other(self, aliases: Sequence[str]) -> tuple[int, ...]:
        """The places of terms that are an effect by another name, and so would be the finding; not
        those of the given model, which are calibrated. And those of a gap that was found: no torque
        moves it, and on its rough cost a fit is lost in what the instants of contacts do.
        """
        had = {t.effect for t in self.given}
        return tuple(
            i
            for i, t in enumerate(self.final.model.terms)
            if t.joint == self.joint
            and (t.effect in aliases or get_effect(t.effect).rough)
            and t.effect not in had
        )

    def seen(self, term: Term, least: float) -> tuple[float, float]:
        """The size of an effect that would be found and claimed, and its torque after calibration,
        ``least`` or more, as a part of the RMS torque. The search begins at a term's size.
        `NOT_SEEN` where even an effect that is not small would not be found.
        """
        key, absorbed = size_of(get_effect(term.effect)), 0
        without, grown, last = None, 1.0, False
        other = self.other(get_effect(term.effect).aliases)
        terms = [t.held() if i in other else t for i, t in enumerate(self.final.model.terms)]
        for _ in range(IMPLANTS):
            model = self.final.model.with_terms((*terms, term.held()))
            large = difference(self.test, model, self.final.model, self.joint) / NOT_SMALL
            if large > 1.0:  # the largest that is tried is near, or has been tried, or is too small
                if last or not large < AMPLE * LARGER:
                    return NOT_SEEN
                grown, last = grown / (AMPLE * large), True
                term = larger(term, 1.0 / (AMPLE * large))
                continue
            without = self._without(model, without, grown)
            lacking, torque = self._short_by(term, without, least)
            if lacking <= 1.0:
                return term.value(key), torque
            absorbed += lacking > NOTHING_LEFT
            if absorbed == ABSORBED or last:
                return NOT_SEEN
            grown = AMPLE * min(lacking, FARTHER)
            term = larger(term, grown)
        return NOT_SEEN

    def _without(self, model: Model, smaller: Scored | None, grown: float) -> Scored:
        """The calibrated numbers and the observer fitted without the implant, the last of the
        ``model``'s terms. They start from those of a ``smaller`` implant, extrapolated by how much
        it has ``grown``, since to first order they follow its size. A fit that does not come near
        the deviance of one that hides the implant ends.
        """
        data, joints = (smaller or self.final).data, (self.joint,)
        handles = joint_handles(data, model, self.joint)
        if smaller is not None:
            at, ended = (get_values(m, handles) for m in (model, smaller.model))
            model = set_values(model, handles, at + grown * (ended - at))
        return fit_scored(
            data,
            model,
            handles,
            joints,
            iterations=ITERATIONS,
            jobs=self.jobs,
            rounds=2,
            goal=self.final.deviance + self._sought(model.terms[-1]) ** 2,
            near=partial(self._near, handles),
        )

    def _near(self, handles: tuple[Handle, ...], data: Data) -> Fit:
        """The final model, with the Jacobian of some numbers under some observer."""
        key = handles, data.bandwidth
        if key not in self._finals:
            model, joints = self.final.model, (self.joint,)
            self._finals[key] = fit(
                data, model, handles, joints=joints, iterations=0, jobs=self.jobs
            )
        return self._finals[key]

    def _sought(self, term: Term) -> float:
        """The root of the deviance that a search must gain with an effect, nine times in ten."""
        worth = max(WAIT + price((term,), self.n), PROMISING * self.n)
        return math.sqrt(worth) + NINE_IN_TEN

    def _short_by(self, term: Term, without: Scored, least: float) -> tuple[float, float]:
        """The factor by which an effect would have to be larger (1 or less: it is seen), and its
        torque.
        """
        test, joint, final = self.test, self.joint, self.final
        torque = difference(test, without.model, final.model, joint)
        found = without.deviance - final.deviance
        settle = max(settling(without, joint), settling(final, joint))
        if settle not in self._scores:
            self._scores[settle] = block_scores(final, test, joint, settle)
        held = evidence(block_scores(without, test, joint, settle) - self._scores[settle])
        log_e = log_e_value(held, without, final, test, joint)
        worse = standing_out(test, window_error(test, without.model, joint), self.errors, joint)
        likely = min(
            _root(found) / self._sought(term),
            _root(2.0 * log_e) / self.root,
            held.z / (CLAIMED + NINE_IN_TEN),
        )
        felt = min(torque / least, worse / NINE_IN_TEN)
        lacking = max(_short(felt), max(_short(likely), LARGER) if likely < 1.0 else 0.0)
        return lacking, torque


def _short(shown: float) -> float:
    """The factor by which what is ``shown`` would have to be larger to be 1."""
    return 1.0 / shown if shown > 0.0 else math.inf


def _root(value: float) -> float:
    return math.sqrt(max(value, 0.0))


