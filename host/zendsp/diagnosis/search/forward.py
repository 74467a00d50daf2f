"""The forward selection at one joint: hypotheses that explain what the calibrated model leaves.

Each round screens the library, fits the promising hypotheses with all calibrated parameters free,
and keeps the most likely. Rounds follow until no step passes. Alternatives to the first step guard
against one effect that imitates two. Finally every found term and every term of the given model has
to justify itself.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import takewhile

import numpy as np

from zendsp.diagnosis.measure.likelihood import Scored, fit_scored
from zendsp.diagnosis.progress import Progress
from zendsp.diagnosis.search.backlash import refine
from zendsp.diagnosis.search.hypothesis import (
    SUFFICIENT,
    JointSearch,
    Rival,
    Step,
    price,
)
from zendsp.diagnosis.search.rounds import GLANCE, WORTH, Rounds
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.diagnosis.search.simpler_laws import split_asymmetry, straightened
from zendsp.diagnosis.search.simplify import simplify
from zendsp.diagnosis.search.white import is_white
from zendsp.physics.calibration.fit import Data, joint_handles
from zendsp.physics.calibration.joint import effective_inertia
from zendsp.physics.effects import get_effect
from zendsp.physics.effects.column_shift import least_shift
from zendsp.physics.effects.creep import ROUND, STRAIGHT
from zendsp.physics.model import Model, Quantity, Term

# start values of a creeping friction: of the fast speed, and s. Of 16 recordings, 0.003 to 0.1 and
# 0 to 10 ms ended at the same numbers
CREEP, LEAD = 0.03, 5e-3
RUNNERS = 4  # hypotheses per round that are tested on the recordings to choose by
# gain per sample, a tenth of the innovations' energy: below it no second effect is looked for
# behind a first
LOOK_AHEAD = 0.1
LONGEST_CHAIN = 6  # most effects of a chain
# most waves over the position in a chain: more are the series of a torque that has no law here, and
# a decision asks whether what lacks depends on the position
MOST_WAVES = 3
FIRST = 0.4  # of the best gain: least gain of a runner-up to be tried as the first step
# times the inertia of a joint's bodies: the search begins with a rotor larger than this. Without
# its rotors a TX40 shows 5.8 and more at joints 4 to 6, where that is needed, and 0.4 to 1.0 at the
# others, where the search finds them anyway
HOLLOW = 2.0


class Searcher:
    """Searches one joint; ``accept`` decides whether a step counts, by held-out evidence."""

    def __init__(
        self,
        data: Data,
        joint: int,
        accept: Callable[..., bool],
        jobs: int,
        progress: Progress,
        given: Model | None = None,
    ) -> None:
        self.rounds = Rounds(data, joint, jobs, progress, given)
        self.joint, self.accept, self.jobs = joint, accept, jobs

    def search(self, base: Scored) -> JointSearch:
        """The likeliest chain of effects that explains what a calibrated model leaves, or one
        effect alone where that does as well.

        Parameters
        ----------
        base : Scored
            The calibrated model.
        """
        rotor = self._rotor(base)
        if rotor is not None:
            found = self._chain(rotor.scored)
            first = Step(rotor, (), base)
            return replace(found, base=base, steps=[first, *found.steps], best=found.final)
        found = self._chain(base)
        if len(found.steps) < 2:
            return found
        chain = found.steps[-1].chosen.scored.deviance + sum(
            step.chosen.price for step in found.steps
        )
        alone = min(self.rounds.round(base), key=lambda r: r.value)
        if (
            alone is found.steps[0].chosen
            or not alone.value < chain
            or not self.accept(base, alone)
        ):
            return found
        return self._chain(base, alone)

    def _rotor(self, base: Scored) -> Rival | None:
        """A rotor as first step, where the bodies of a file have hardly any of the inertia that the
        recordings show, as in a file without rotors. No observer can follow such a joint, so
        nothing else could be seen. None elsewhere.
        """
        data, model, joint = self.rounds.data, base.model, self.joint
        shown = data.ranges.get((f"inertia {joint}", 0))
        if shown is None or any(t.effect == "inertia" for t in model.at(joint)):
            return None
        amount = math.sqrt(shown[0] * shown[1])
        own = np.concatenate([effective_inertia(rec[joint - 1], model) for rec in data.records])
        if amount < HOLLOW * float(np.mean(own)):
            return None
        term = Term("inertia", joint, {"amount": Quantity(amount)})
        fuller = model.with_terms((*model.terms, term))
        handles = joint_handles(data, fuller, joint)
        scored = fit_scored(data, fuller, handles, (joint,), jobs=self.jobs)
        terms = scored.model.terms[-1:]
        return Rival("inertia", joint, scored, price(terms, self.rounds.n), terms, ())

    def further(self, found: JointSearch) -> JointSearch:
        """A search that goes on from its final model."""
        current = found.final
        if is_white(current, self.joint):
            return found
        if self.rounds.glance(current, frozenset()) >= current.deviance - WAIT:
            return found
        return self._chain(current, found=found)

    def leads(self, creeping: Scored, base: Scored) -> bool:
        """Whether a dry friction that creeps makes a model likelier than every other hypothesis,
        where its inertia is known.
        """
        if self._rotor(base) is not None:
            return False
        paid = price(creeping.model.terms[-1:], self.rounds.n)
        return all(creeping.deviance + paid < r.value - WAIT for r in self.rounds.round(base))

    def _goes_on(self, current: Scored, rivals: list[Rival]) -> bool:
        """Whether the searches behind the first hypotheses are worth trying: one of these can be a
        step, or may wait for the next one. Beside a gap always, since each step moves it.
        """
        had, first = current.model.at(self.joint), rivals[:RUNNERS]
        return (
            any(get_effect(t.effect).rough for t in had)
            or any(self.accept(current, r) for r in first)
            or self._waits(current, first) is not None
        )

    def _waits(self, current: Scored, rivals: list[Rival]) -> Rival | None:
        """The step that waits for the next one where none passes by itself: the first likely one
        that the recordings to choose by do not contradict, if another one is worth a step behind
        it; or a likelier one that they contradict alone and accept together with another, if the
        two are likelier still. Alone it was bent: a lag that did a spring's work had 5 ms in place
        of 4, a Coulomb friction beside which a drag was hidden 12 N mm in place of 15.
        """
        least = max(WORTH, LOOK_AHEAD * self.rounds.n)
        likely = [r for r in rivals if _gain(current, r) > least]
        bent = [*takewhile(lambda r: not self.accept(current, r, waits=True), likely)]
        seen = frozenset(r.effect for r in rivals[:GLANCE])
        found: list[tuple[float, Rival]] = []
        for k, first in enumerate(likely[: len(bent) + 1]):
            ahead = self.rounds.glance(first.scored, seen)
            if ahead < first.scored.deviance - least:
                both = ahead + first.price
                found.append((self._together(current, first) if k < len(bent) else both, first))
        total, best = min(found, key=lambda pair: pair[0], default=(math.inf, None))
        return best if total < math.inf else None

    def _together(self, current: Scored, first: Rival) -> float:
        """The deviance plus price of a step with the likeliest one behind it that the recordings to
        choose by accept together with it; infinite where they accept none.
        """
        behind = self.rounds.round(first.scored)[:RUNNERS]
        both = (replace(r, price=first.price + r.price) for r in behind)
        return min((r.value for r in both if self.accept(current, r)), default=math.inf)

    def softened(self, base: Scored) -> Scored | None:
        """The calibrated model with a dry friction that creeps instead of holding; None where it
        has no dry friction, or creep does not pay, or is larger than solvers and grease have it: a
        ripple of an arm's last joint was a creep with a lead of 0.1 s.
        """
        had = base.model.at(self.joint)
        holds = any(get_effect(t.effect).site == "dry" for t in had)
        if not (holds and math.isfinite(base.deviance)) or any(t.effect == "creep" for t in had):
            return None
        best = self.creeping(base)
        terms = best.model.terms[-1:]
        # a lead may be nothing, as a tanh has none
        numbers = zip(best.fit.handles, best.fit.at_bound, strict=True)
        own = [h.key for h, bound in numbers if bound and h.index == len(best.model.terms) - 1]
        if any(terms[0].value(key) > 0.0 for key in own):
            return None
        creep = Rival("creep", self.joint, best, price(terms, self.rounds.n), terms, ())
        return best if self.accept(base, creep) else None

    def late_log(self, base: Scored) -> Scored | None:
        """The calibrated model with a command column that is late by less than a claimed shift;
        None where it is not. No machine responds before its command, so such a lead is in the log,
        whatever law resembles it.
        """
        had = base.model.at(self.joint)
        if not math.isfinite(base.deviance) or any(t.effect == "column_shift" for t in had):
            return None
        first = self.rounds.data.records[0][self.joint - 1]
        most = least_shift(first.sample_time, first.between > 0.0)
        term = Term("column_shift", self.joint, {"time": Quantity(0.5 * most)})
        model = base.model.with_terms((*base.model.terms, term))
        handles = joint_handles(base.data, model, self.joint)
        best = fit_scored(base.data, model, handles, (self.joint,), jobs=self.jobs)
        terms = best.model.terms[-1:]
        pays = best.deviance + price(terms, self.rounds.n) < base.deviance - WAIT
        return best if pays and 0.0 < terms[0].value("time") < most else None

    def creeping(self, base: Scored, *known: Term) -> Scored:
        """A model with creeping dry friction, the likelier of a round and a straight one.

        Parameters
        ----------
        known : Term
            A creep to start from; others are tried only where it makes the model no likelier.
        """
        fast = max(rec[self.joint - 1].scale.speed for rec in self.rounds.data.records)
        starts = (
            Term(
                "creep",
                self.joint,
                {
                    "speed": Quantity(CREEP * fast),
                    "lead": Quantity(LEAD * shape, free=shape == STRAIGHT),
                    "shape": Quantity(shape, free=False),
                },
            )
            for shape in (ROUND, STRAIGHT)
        )
        tried = []
        for term in (*known, *starts):
            model = base.model.with_terms((*base.model.terms, term))
            handles = joint_handles(base.data, model, self.joint)
            tried.append(fit_scored(base.data, model, handles, (self.joint,), jobs=self.jobs))
            if len(tried) == len(known) and tried[-1].deviance < base.deviance:
                break
        return min(tried, key=lambda scored: scored.deviance)

    def _chain(
        self, base: Scored, begin: Rival | None = None, found: JointSearch | None = None
    ) -> JointSearch:
        """The search that adds effects to a model until none passes, the first of them ``begin``
        where given; the model is a calibrated one, or what was ``found`` so far.

        A likely step that fails on the recordings to choose by may need another effect that is
        still hidden: it waits for the next one, and both are judged together (``_waits``).
        """
        found = replace(found, steps=[*found.steps]) if found else JointSearch(self.joint, base)
        current = held = base  # held: the model of all accepted steps
        waiting: list[Step] = []
        while len(found.steps) + len(waiting) < LONGEST_CHAIN:
            if _waves(found.steps) >= MOST_WAVES:
                break
            if is_white(current, self.joint) and not (current is base and self._shows(base)):
                break
            rivals = self.rounds.round(current)
            if not found.tried:
                found.tried = list(rivals)
            if not rivals or current.deviance - rivals[0].value < WAIT:
                break
            if begin is not None and current is base:
                rivals = [begin, *[r for r in rivals if r is not begin]]
            else:
                rivals = _simplest_sufficient(rivals, current)
                if not found.steps and not waiting and self._goes_on(current, rivals):
                    rivals = self._best_first(current, rivals)
            since = waiting[0].before if waiting else current
            paid = sum(step.chosen.price for step in waiting)
            passing = (
                r for r in rivals[:RUNNERS] if self.accept(since, replace(r, price=paid + r.price))
            )
            holds = next(passing, None)
            look_on = holds is None and not waiting
            waits = self._waits(current, rivals[:RUNNERS]) if look_on else None
            chosen = self._in_gap(current, holds or waits or rivals[0])
            rivals = [chosen, *[r for r in rivals if r.effect != chosen.effect]]
            step = Step(chosen, tuple(rivals[1:]), current)
            if holds is not None:
                found.steps += [*waiting, step]
                waiting = []
            elif waits is not None:
                waiting = [replace(step, alone=False)]
            else:
                break
            current = rivals[0].scored
            if not waiting:
                current = split_asymmetry(found, current, self.jobs)
                current = held = straightened(found, current, self.jobs)
        if held is not base:
            found.best = held
            found.best, dropped = simplify(found, self.rounds.n, self.jobs)
            found.dropped = (*found.dropped, *dropped)
        return found

    def _shows(self, base: Scored) -> bool:
        """Whether white innovations hide an effect, such as a delay of a tenth of a row: the
        screen's slower observer promises enough for a step.
        """
        n = self.rounds.n
        best = self.rounds.options(base)[:1]
        return any(share * n > WAIT + price(option.terms, n) for share, option in best)

    def _in_gap(self, current: Scored, chosen: Rival) -> Rival:
        """A step beside an earlier gap, with the gap searched again: its optimum is so narrow that
        the step moved it out of reach.
        """
        beside = [t for t in chosen.scored.model.at(self.joint) if t.effect != chosen.effect]
        if not any(get_effect(t.effect).rough for t in beside):
            return chosen
        return replace(
            chosen, scored=refine(chosen.scored, self.joint, current.deviance, WORTH, self.jobs)
        )

    def _best_first(self, current: Scored, rivals: list[Rival]) -> list[Rival]:
        """The best search among those that start with a runner-up. Where two effects act, the first
        of the best pair need not be the best single one.
        """
        gain = current.deviance - rivals[0].value
        if (
            is_white(rivals[0].scored, self.joint)
            or _gain(current, rivals[0]) < LOOK_AHEAD * self.rounds.n
        ):
            return rivals
        second = self.rounds.round(rivals[0].scored)
        if not second or rivals[0].scored.deviance - second[0].value < WAIT:
            return rivals
        # the likeliest of each round, as a glance estimates it: their order is another matter
        best, total = rivals[0], _likeliest(second) + rivals[0].price
        seen = frozenset(r.effect for r in (*rivals[:GLANCE], *second[:GLANCE]))
        for first in rivals[1:4]:
            if current.deviance - first.value < FIRST * gain or _general(first, rivals[0]):
                continue
            margin = max(10.0, (1.0 - SUFFICIENT) * (current.deviance - total))
            if self.rounds.glance(first.scored, seen) + first.price > total - 0.5 * margin:
                continue
            behind = self.rounds.round(first.scored)
            if behind and _likeliest(behind) + first.price < total - margin:
                best, total = first, _likeliest(behind) + first.price
        return [best, *[r for r in rivals if r is not best]]


def _waves(steps: list[Step]) -> int:
    """The count of effects that repeat with the position."""
    keys = (t.parameters for step in steps for t in step.chosen.terms)
    return sum("order" in had or "period" in had for had in keys)


def _likeliest(rivals: list[Rival]) -> float:
    """The deviance plus the price of the likeliest of some hypotheses."""
    return min(r.value for r in rivals)


def _gain(before: Scored, rival: Rival) -> float:
    """The gain of a hypothesis under its own observer or the slower one of ``Rounds.order``,
    whichever is larger.
    """
    own = before.deviance - rival.value
    return max(own, rival.rank) if math.isfinite(rival.rank) else own


def _freedom(rival: Rival) -> float:
    """The count of fitted parameters, plus one for a hidden state, and one for a joint chosen among
    several.
    """
    count = 0.0
    for term in rival.terms:
        effect = get_effect(term.effect)
        count += sum(p.fitted for p in effect.parameters) + effect.hidden - effect.odds
        count += "from_joint" in term.parameters
    return count - len(rival.replaces)


def _simplest_sufficient(rivals: list[Rival], before: Scored) -> list[Rival]:
    """The hypotheses with nearly all of the best gain, the simplest first. A later step can add
    what it leaves.
    """
    gain = rivals[0].rank
    enough = [r for r in rivals if r.rank >= SUFFICIENT * gain and before.deviance - r.value > WAIT]
    first = min(enough or rivals[:1], key=lambda r: (_freedom(r), -r.rank))
    return [first, *[r for r in rivals if r is not first]]


def _general(rival: Rival, other: Rival) -> bool:
    """Whether one of two hypotheses contains the other as a special case."""
    return (
        other.effect in get_effect(rival.effect).replaces
        or rival.effect in get_effect(other.effect).replaces
    )
