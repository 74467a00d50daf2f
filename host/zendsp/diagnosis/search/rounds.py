"""Hypotheses at one joint, fitted upon a model.

The library is screened, promising effects get a short fit with all calibrated parameters free
(``short_fits.py``), and the best of these a full one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from zendsp.diagnosis.measure.likelihood import (
    Scored,
    deviance,
    fit_scored,
    informative,
    slower,
)
from zendsp.diagnosis.measure.significance import counterpart, vanishes
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.backlash import refine
from zendsp.diagnosis.search.candidates import (
    first_look,
    loosened,
    screened,
    simulated,
    starts_of,
)
from zendsp.diagnosis.search.hypothesis import UNSETTLED, Rival, price, with_numbers
from zendsp.diagnosis.search.screen import Candidate, Screen
from zendsp.diagnosis.search.short_fits import WAIT, ShortFits, settled
from zendsp.physics.calibration.bounds import parameter_bounds
from zendsp.physics.calibration.fit import Data, fit, joint_handles
from zendsp.physics.calibration.joint import facts, own_terms
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect
from zendsp.physics.effects.axes import orders
from zendsp.physics.kernel.threads import Each, threads
from zendsp.physics.model import Model, Term
from zendsp.physics.term_numbers import added_inertia

PROMISING = 0.002  # share of the cost that a screen must promise
SHORTLIST = 9
# of the largest promised gain: a hypothesis that promises as much is fitted, however many do.
# Hypotheses that won from the third place of a screen or below had promised 0.65 of it and more; of
# an arm's gain, the tenth of thirteen with 0.77 and more, nothing else was tried
AS_PROMISING = 0.5
LISTED = 3  # least number of hypotheses fitted in a round, whatever the screen promises
FINALISTS = 4
# more of them where those found nothing: a drag of 0.5 % was among the first two, but thinned
# recordings misled the other numbers and hid its gain
PROMISED = 2
GLANCE = 4  # hypotheses of a round that is only looked at
# deviance of a step that may wait for another, and of a gap whose narrow optimum is searched
WORTH = 10 * WAIT
# of the best gain: hypotheses with less are not reordered, and a transmission that promises less is
# not fitted. A true transmission gained 1.4 to 10 times its promise, a gap up to 5 times
REACH = 0.1
# of the least gain that counts: an effect that promises less on all samples is not fitted. Effects
# that counted gained up to 9.4 times their promise (a voltage limit), others up to 5.5 times
PROMISED_ON_ALL = 0.1


def _promise(group: Sequence[Candidate]) -> float:
    """The decrease of the deviance per sample that a transmission promises; nan for others."""
    slow = get_effect(group[0].effect).family == "transmission"
    return group[0].gain if slow else math.nan


def below_least(term: Term, data: Data, joint: int, model: Model | None = None) -> bool:
    """Whether a term is below the least size that its effect says a recording can show, beside the
    other terms of a ``model``.
    """
    least = get_effect(term.effect).least
    if least is None:
        return False
    record = max((rec[joint - 1] for rec in data.records), key=lambda r: r.n)
    return any(abs(term.value(name)) < size for name, size in least(facts(record, model)).items())


class Rounds:
    """The hypotheses at one joint, in a round for each model.

    Parameters
    ----------
    joint : int
        1-based.
    jobs : int
        Threads.
    progress : callable
        Receives a sentence at each stage.
    given : Model, optional
        The model before it was calibrated.
    """

    def __init__(
        self, data: Data, joint: int, jobs: int, progress: Progress, given: Model | None = None
    ) -> None:
        self.data, self.joint, self.jobs = data, joint, jobs
        self.progress, self.given = progress, given
        self.n = informative(data, joint)
        self.short = ShortFits(joint, jobs, self.n)
        self._rounds: dict[int, tuple[Scored, list[Rival]]] = {}
        self._screens: dict[int, tuple[Scored, Screen]] = {}
        self._options: dict[object, tuple[Scored, list[tuple[float, Candidate]]]] = {}

    def options(
        self, current: Scored, only: frozenset[str] = frozenset()
    ) -> list[tuple[float, Candidate]]:
        """The promises of a screen upon a model, see ``screened``."""
        key = id(current), only
        if key not in self._options:
            data, model = current.data, current.model
            found = screened(data, model, self.joint, jobs=self.jobs, only=only)
            self._options[key] = current, found
        return self._options[key][1]

    def round(self, current: Scored) -> list[Rival]:
        """The promising hypotheses, fitted upon a model, the most likely first; one entry per
        effect.
        """
        if id(current) not in self._rounds:
            self._rounds[id(current)] = (current, self._round(current))
        return self._rounds[id(current)][1]

    def stand_ins(self, current: Scored, effects: frozenset[str]) -> list[Rival]:
        """The named effects only, fitted upon a model, the most likely first."""
        return self._round(current, effects)

    def few_periods(self, current: Scored) -> Rival | None:
        """A ripple a whole number of times a turn, with fewer periods in the travel than a search
        takes, fitted upon a model; None where there is none, or the joint slides. Too little of it
        is seen for a finding, but it may be what another law over the position imitates.
        """
        ripple, records = get_effect("ripple"), [rec[self.joint - 1] for rec in self.data.records]
        known = facts(max(records, key=lambda r: r.n))
        least, _ = parameter_bounds("ripple", "order", records[0])
        few = [{"order": n} for n in orders(known) if n < least]
        if known.slides or not few:
            return None
        term = self._screen_of(current).best_of("ripple", few).terms[0]
        numbers = {**term.parameters, "order": replace(term.parameters["order"], free=False)}
        model = current.model.with_terms((*current.model.terms, replace(term, parameters=numbers)))
        handles, joints = joint_handles(self.data, model, self.joint), (self.joint,)
        scored = fit_scored(current.data, model, handles, joints, jobs=self.jobs)
        terms = scored.model.terms[-1:]
        return Rival(ripple.name, self.joint, scored, price(terms, self.n), terms, ())

    def glance(self, current: Scored, seen: frozenset[str]) -> float:
        """An estimate of the least deviance plus price with one more effect, from short fits of the
        most promising ones.

        Of effects with hidden states only those in ``seen`` are tried, which did well elsewhere in
        this search.
        """
        listed = [starts_of(c, current.data) for _, c in self.options(current)[:GLANCE]]
        hidden = frozenset(e for e in seen if get_effect(e).scan)
        listed += (
            simulated(current.data, current.model, self.joint, hidden, self.jobs, self.given)
            if hidden
            else []
        )
        with threads(self.jobs) as each:
            found = list(each(lambda group: self.short.quick(current, group), listed))
        return min((r.value for r in found if r is not None), default=math.inf)

    def order(self, current: Scored, rivals: list[Rival]) -> list[Rival]:
        """The hypotheses in the order of their gains.

        Where even the best of them needs a fast observer, much is still missing, and a fast
        observer follows slow errors. The order is then that of the gains under an observer four
        times slower.
        """
        ranked = [replace(r, rank=current.deviance - r.value) for r in rivals]
        if len(ranked) < 2 or ranked[0].scored.data.bandwidth[self.joint - 1] <= UNSETTLED:
            return ranked
        band = max(8.0, ranked[0].scored.data.bandwidth[self.joint - 1] / 4)
        slow = current.data.at_bandwidth(self.joint, settled(current, self.joint, band))
        joints = (self.joint,)
        base = fit(
            first_look(slow, current.model, self.joint),
            current.model,
            current.fit.handles,
            joints=joints,
            iterations=5,
            tolerance=1e-3,
            jobs=self.jobs,
            brief=True,
        )
        level = deviance(slow, base.model, joints)
        reach = [r for r in ranked[:8] if r.rank > REACH * ranked[0].rank and r.rank > WAIT]

        def slowly(rival: Rival) -> Rival:
            result = fit(
                first_look(slow, rival.scored.model, self.joint),
                rival.scored.model,
                rival.scored.fit.handles,
                joints=joints,
                iterations=6,
                tolerance=1e-3,
                jobs=1,
                brief=True,
            )
            return replace(rival, rank=level - deviance(slow, result.model, joints) - rival.price)

        with threads(self.jobs) as each:
            again = sorted(each(slowly, reach), key=lambda r: -r.rank)
        return [*again, *[r for r in ranked if r not in reach]] if again else ranked

    def _round(self, current: Scored, only: frozenset[str] = frozenset()) -> list[Rival]:
        self.progress(Step.SEARCHING.says(f"joint {self.joint}: screening the library"))
        options = self.options(current, only)
        if only:
            listed = [starts_of(c, current.data) for _, c in options]
        else:
            listed = self._listed(current, options)
        idle = [] if only else [g for g in listed if self._is_idle(current, g)]
        # what takes longest comes first, so that no thread is left with it at the end
        listed = [
            *simulated(current.data, current.model, self.joint, only, self.jobs, self.given),
            *loosened(current.model, self.joint, only),
            *[g for g in listed if not any(g is i for i in idle)],
        ]
        self.progress(Step.SEARCHING.says(f"joint {self.joint}: fitting {len(listed)} hypotheses"))
        with threads(self.jobs) as each:
            quick = self._looked_at(current, listed, each, all_of_them=bool(only))
            if not only:
                quick += self._overlooked(current, options, [*listed, *idle], quick, each)
            quick.sort(key=lambda r: r.value)
            reach = 0.5 * (current.deviance - quick[0].value) if quick else 0.0
            # an idle hypothesis gains nothing and costs its price: the best has to be likelier
            least = current.deviance + min(map(self._price_of, idle), default=math.inf)
            finalists = [
                r
                for r in quick[:FINALISTS]
                if current.deviance - r.value >= reach or (r is quick[0] and r.value <= least)
            ]
            # a short fit may end far from its minimum. Where nothing is found yet the first law
            # decides what follows
            if self.given is None or len(current.model.terms) <= len(self.given.terms):
                ended = [r for r in quick if not any(r is f for f in finalists)]
                first = min((r.value for r in quick), default=0.0)
                finalists += [r for r in ended if r.value - self.short.promised(r) < first]
            others = [r for r in quick if not any(r is f for f in finalists)]
            if quick and current.deviance - quick[0].value < WAIT and not only:
                more = self._promising(current, others)
                finalists += more
                others = [r for r in others if not any(r is m for m in more)]
            worth = math.inf if only else WORTH  # a stand-in need not be at its best
            full = list(each(lambda r: self._full(current, r, worth), finalists))
        rivals = [
            r
            for r in (*full, *self._bare(full), *others)
            if not any(
                # as a stand-in it may be smaller than a search takes
                vanishes(r.scored.fit, t) or (not only and self.too_small(r, t))
                for t in r.terms
            )
            and self._possible(current, r)
        ]
        rivals.sort(key=lambda r: r.value)
        return self.order(current, rivals) if rivals else []

    def _listed(
        self, current: Scored, options: Sequence[tuple[float, Candidate]]
    ) -> list[list[Candidate]]:
        """The hypotheses of a screen that are fitted: those that promise most, all that promise
        nearly as much, and those of which every machine may have some, or that a screen hardly
        sees.
        """
        alike = AS_PROMISING * self._deviance_of(options[0][0]) if options else 0.0
        best = [
            c
            for i, (share, c) in enumerate(options)
            if share > PROMISING and (i < SHORTLIST or self._deviance_of(share) >= alike)
        ]
        if len(best) < LISTED:
            best = [c for _, c in options[:LISTED]]
        groups = [starts_of(c, current.data) for c in best]
        first = {c.effect for c in best}
        rest = [(c, get_effect(c.effect)) for _, c in options if c.effect not in first]
        return [*groups, *([c] for c, effect in rest if effect.common or effect.hides)]

    def _looked_at(
        self, current: Scored, listed: list[list[Candidate]], each: Each, *, all_of_them: bool
    ) -> list[Rival]:
        """Short fits of hypotheses. Transmissions take far longer and are fitted only where they
        promise something beside the others, or with ``all_of_them``.
        """

        def short(groups: list[list[Candidate]]) -> list[Rival]:
            found = each(lambda group: self.short.quick(current, group), groups)
            return [r for r in found if r is not None]

        slow = [g for g in listed if not all_of_them and math.isfinite(_promise(g))]
        quick = short([g for g in listed if not any(g is s for s in slow)])
        best = max((current.deviance - r.value for r in quick), default=0.0)
        return quick + short([g for g in slow if _promise(g) * self.n >= REACH * best])

    def _overlooked(
        self,
        current: Scored,
        options: Sequence[tuple[float, Candidate]],
        listed: list[list[Candidate]],
        quick: list[Rival],
        each: Each,
    ) -> list[Rival]:
        """Short fits of unlisted hypotheses that promise more than any listed one gained. With a
        fast observer a screen promises much for many effects, and no more for the true one.
        """
        best = max((current.deviance - r.value for r in quick), default=0.0)
        seen = {c.effect for group in listed for c in group}
        more = [
            starts_of(c, current.data)
            for share, c in options
            if c.effect not in seen and share > PROMISING and self._deviance_of(share) > best
        ]
        more = [group for group in more if not self._is_idle(current, group)]
        found = each(lambda group: self.short.quick(current, group), more)
        return [r for r in found if r is not None]

    def _deviance_of(self, share: float) -> float:
        """Decrease of the deviance with a share of the cost."""
        return -self.n * math.log1p(-min(share, 1.0 - 1e-9))

    def _is_idle(self, current: Scored, group: list[Candidate]) -> bool:
        """Whether a screened hypothesis promises too little for a step on all samples, under the
        model's own observer, and under a slow one too where that is fast. (A screen on thinned
        samples may promise more.) False for hypotheses that replace a term or that a screen cannot
        see.
        """
        if get_effect(group[0].effect).hides or group[0].replaces:
            return False
        least = WAIT + self._price_of(group)
        if self._promised(current, group) > PROMISED_ON_ALL * least:
            return False
        band = settled(current, self.joint)
        if current.data.bandwidth[self.joint - 1] <= band:
            return True
        slow = self.short.under(current, current.data.at_bandwidth(self.joint, band))
        behind = max(0.0, slow.deviance - current.deviance)
        return self._promised(slow, group) < PROMISED_ON_ALL * (least + behind)

    def _promised(self, current: Scored, group: list[Candidate]) -> float:
        """The decrease of the deviance that a hypothesis promises on all samples, to first order.
        """
        screen = self._screen_of(current)
        gain = max(screen.gain_of(candidate) for candidate in group)
        return self._deviance_of(gain / float(screen.r @ screen.r))

    def _screen_of(self, current: Scored) -> Screen:
        """A screen around a model, on all samples and under its own observer."""
        if id(current) not in self._screens:
            joints, handles = (self.joint,), current.fit.handles
            data, model = current.data, current.model
            here = fit(data, model, handles, joints=joints, iterations=0, jobs=self.jobs)
            self._screens[id(current)] = current, Screen(data, here, self.joint, joints)
        return self._screens[id(current)][1]

    def _price_of(self, group: list[Candidate]) -> float:
        return price(group[0].terms, self.n)

    def _bare(self, rivals: list[Rival]) -> list[Rival]:
        """The simpler effect to which the likeliest hypothesis has shrunk, fitted. The search for a
        gap or a stiffening spring may end at a plain spring that no start value of a spring leads
        to.
        """
        best = min(rivals, key=lambda r: r.value, default=None)
        bare = get_effect(best.effect).bare if best else ""
        if not best or not bare or best.replaces or not vanishes(best.scored.fit, best.terms[0]):
            return []
        fitted = counterpart(best.scored.model.terms, best.terms[0])
        numbers = {p.name: fitted.value(p.name) for p in get_effect(bare).parameters}
        term = make_term(get_effect(bare), self.joint, numbers)
        model = best.scored.model
        model = model.with_terms(tuple(term if t is fitted else t for t in model.terms))
        handles, joints = joint_handles(self.data, model, self.joint), (self.joint,)
        scored = fit_scored(best.scored.data, model, handles, joints, jobs=self.jobs)
        return [Rival(bare, self.joint, scored, price((term,), self.n), (term,), ())]

    def _promising(self, current: Scored, rivals: list[Rival]) -> list[Rival]:
        """The hypotheses with the largest gain on the thinned recordings that they were fitted to,
        tried before the search ends with nothing. On all samples their other numbers, fitted to the
        thinned ones, may have cost more than the gain.
        """
        if self.short.misleads(current):
            return []
        gains = [self.short.gain_of_look(current, r.scored.model) - r.price for r in rivals]
        best = sorted(zip(gains, range(len(rivals)), strict=True), reverse=True)[:PROMISED]
        return [rivals[i] for gain, i in best if gain > WAIT]

    def too_small(self, rival: Rival, term: Term) -> bool:
        """Whether a term is below the least size that its effect says a recording can show."""
        fitted = counterpart(rival.scored.model.terms, term)
        return below_least(fitted, self.data, self.joint, rival.scored.model)

    def _possible(self, current: Scored, rival: Rival) -> bool:
        """Whether the numbers of all terms found so far are possible for a machine: no joint has a
        negative inertia, and what was too small to be claimed (a log that is late by a part of a
        row) stays so. A lag of 4.8 ms in a log that is late by as much imitated a spring.
        """
        late = (t for t in current.model.at(self.joint) if get_effect(t.effect).family == "timing")
        small = [t for t in late if below_least(t, self.data, self.joint)]
        left = [t.effect for t in rival.scored.model.at(self.joint)]
        if any(t.effect in left and not self.too_small(rival, t) for t in small):
            return False
        model = rival.scored.model
        bare = model.with_terms(own_terms(model.terms))
        inertia, _ = self.data.records[0][self.joint - 1].inertia_and_bias(bare)
        if float(np.min(inertia)) + added_inertia(bare, self.joint) <= 0.0:
            return False
        for term in rival.scored.model.at(self.joint):
            possible = get_effect(term.effect).possible
            if possible is not None and not possible(
                {name: q.value for name, q in term.parameters.items()}
            ):
                return False
        return True

    def _full(self, current: Scored, rival: Rival, worth: float) -> Rival:
        jobs = self.jobs  # the longest of them ends alone
        data, model = rival.scored.data, rival.scored.model
        handles = joint_handles(data, model, self.joint)
        scored = fit_scored(data, model, handles, (self.joint,), jobs=jobs)
        options = [scored] if scored.deviance <= rival.scored.deviance else [rival.scored]
        if get_effect(rival.effect).rough:
            options.append(refine(options[0], self.joint, current.deviance, worth, jobs))
        for term in rival.terms:
            for numbers in get_effect(term.effect).tries:
                other = with_numbers(rival.scored.model, term.effect, self.joint, numbers)
                options.append(
                    fit_scored(data, other, handles, (self.joint,), jobs=jobs, rounds=2)
                )
        best = min(options, key=lambda s: s.deviance)
        return replace(rival, scored=slower(best, self.joint, jobs))
