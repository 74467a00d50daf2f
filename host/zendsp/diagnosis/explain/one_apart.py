"""Recordings that do not agree: what is missing is found in some, and the others are asked beside
that for their own load, friction or zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from zendsp.diagnosis.data.prepare import of_one_sensor, prepare
from zendsp.diagnosis.data.signals import Parts, Signals
from zendsp.diagnosis.data.split import halves, split
from zendsp.diagnosis.decide.claims import LAWS_OF, Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.other_load import of_one
from zendsp.diagnosis.decide.own_numbers import (
    between,
    by_recording,
    fitted_to_common,
    may_be_zeroed_elsewhere,
    of_numbers,
    of_zeros,
    other_zeros,
    own_of_one,
)
from zendsp.diagnosis.decide.thresholds import LAWFUL, PREDICTED
from zendsp.diagnosis.explain.machine import Found, find_once
from zendsp.diagnosis.measure.discrepancy import beyond, discrepancy
from zendsp.diagnosis.measure.likelihood import Scored
from zendsp.diagnosis.progress import Progress, Step
from zendsp.physics.calibration.fit import Data
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model
from zendsp_protocol.texts import enumerated

Three = tuple[list[Signals], list[Signals], list[Signals]]


@dataclass(frozen=True)
class Rest:
    """Some of the recordings: to fit to, to choose by, to test on."""

    signals: Three
    parts: Parts


def without(
    signals: Sequence[Sequence[Signals]], names: Sequence[str], given: Model
) -> Rest | None:
    """The recordings without those named; None where too few are left to diagnose."""
    fit, choose, test = (
        [s for s in part if (s.whole or s.name) not in names] for part in of_one_sensor(signals)
    )
    if not fit or not (choose or test):
        return None
    choose, test = choose or test, test or choose
    untouched = prepare(test, given, 64.0)
    if choose is test or signals[1] is signals[2]:
        choose, chosen = test, untouched
    else:
        chosen = prepare(choose, given, 64.0)
    return Rest((fit, choose, test), Parts(prepare(fit, given, 64.0), chosen, untouched))


def split_alone(one: Signals, given: Model) -> Rest | None:
    """One recording by itself, in three parts; None where it is too short."""
    begin, end, _ = split([one])
    choose, test, _ = halves(end)
    return without((begin, choose, test), [], given)


def without_one(
    found: Found, signals: Sequence[Sequence[Signals]], given: Model, jobs: int, tell: Progress
) -> Found | None:
    """The findings without the one recording whose numbers are its own, and its load. None where
    there is none, or where these numbers, beside what the others show, do not explain it.

    Asked of a single joint that lacks torque without a law: numbers between those of two loads
    leave a torque everywhere, which hides what is missing in both.
    """
    decision = found.decisions[0]
    if given.joints > 1 or not _is_open(decision):
        return None
    differs = own_of_one(found.parts, decision.base, given, 1, jobs)
    if not differs:
        return None
    name = differs[0].recording
    rest = without(signals, [name], given)
    if rest is None:
        return None
    tell(Step.ASSEMBLING.says(f"once more, without {name}, which has its own numbers"))
    again = find_once(rest.parts, given, jobs, tell)
    (decided,) = again.decisions
    if _is_open(decided) or beyond(decided.after.value, decided.known.all) > LAWFUL:
        return None
    data = by_recording(found.parts, given, 1)[name]
    load = _load(name, data, rest.parts.fit, decided, given, jobs)
    if load is not None:
        return replace(again, loads=(load,))
    own = fitted_to_common(data, decided.final, 1, jobs)
    if not _explained(data, decided.final, own):
        return None
    said = of_numbers(between(name, own.fit, decided.final.fit, given, 1))
    if decided.kind is Verdict.COMPLETE:  # a friction of its own is no finding
        decision = replace(decision, differs=said) if decision.loads else decision
        return replace(found, decisions=[decision]) if decision.loads else None
    return replace(again, decisions=[replace(decided, differs=said)])


def _load(
    name: str, data: Data, fit: Data, decided: Decision, given: Model, jobs: int
) -> Finding | None:
    """The load of a recording, where inertia and gravity alone explain it, and the recordings of
    the ``fit`` contradict these numbers.
    """
    others = decided.final
    own = fitted_to_common(data, others, 1, jobs, of_body=True)
    if not _explained(data, others, own) or discrepancy(fit, own.model, 1).value < LAWFUL:
        return None
    lacks, left = (discrepancy(data, s.model, 1).value for s in (others, own))
    return of_one(name, own, others, (lacks, left), given)


def _explained(data: Data, others: Scored, own: Scored) -> bool:
    """Whether a recording lacks torque with the numbers of the others, and with its own less than
    ``LAWFUL`` and than half of that energy.
    """
    lacks, left = (discrepancy(data, s.model, 1).value for s in (others, own))
    return left < LAWFUL < lacks and left**2 < (1.0 - PREDICTED) * lacks**2


def by_one_alone(
    found: Found, signals: Sequence[Sequence[Signals]], given: Model, jobs: int, tell: Progress
) -> Found:
    """The findings; where recordings of a joint without gravity lack torque, those of the longest
    recording alone, where they explain all others with zeros of the position of their own.
    """
    decision = found.decisions[0]
    pushed = decision.kind is Verdict.DISTURBANCE or decision.bursts is not None
    placed = _is_open(decision) and _may_lie_over_position(decision)
    if pushed or decision.loads or not placed or not may_be_zeroed_elsewhere(given):
        return found
    every = by_recording(found.parts, given, 1)
    if len(every) < 2:
        return found
    longest = max(signals[0], key=lambda s: len(s.time))
    name = longest.whole or longest.name
    others = [s.whole or s.name for part in signals for s in part if (s.whole or s.name) != name]
    alone = without(signals, others, given) or split_alone(longest, given)
    if alone is None:
        return found
    tell(Step.ASSEMBLING.says(f"once more, {name} alone"))
    again = find_once(alone.parts, given, jobs, tell)
    rest = {n: data for n, data in every.items() if n != name}
    return with_other_zeros(again, rest, jobs) or found


def with_other_zeros(found: Found, every: Mapping[str, Data], jobs: int) -> Found | None:
    """The findings of some recordings, and how far the zeros of others are from theirs; None where
    that does not explain all of these, or no zero is another.
    """
    decision = found.decisions[0]
    if decision.kind is not Verdict.MISSING or _is_open(decision):
        return None
    zeros = other_zeros(every, decision.final, decision.joint, jobs)
    if not zeros:
        return None
    own = by_recording(found.parts, decision.final.model, decision.joint)
    those = enumerated(n for n in own if n not in every)
    said = of_zeros(zeros, those, decision.final, decision.joint)
    return replace(found, decisions=[replace(decision, differs=said)])


def _may_lie_over_position(decision: Decision) -> bool:
    """Whether what has no law may be a torque over the position: not where its mechanism is known
    and is none, as fluid friction.
    """
    nameless = [c.mechanism for c in decision.claims if c.effect == "unknown"]
    laws = [get_effect(e) for m in nameless for e in LAWS_OF.get(m, ())]
    return not laws or any(law.over == "position" for law in laws)


def _is_open(decision: Decision) -> bool:
    """Whether a joint lacks torque without a law, or seems to be pushed."""
    nameless = any(c.effect == "unknown" for c in decision.claims)
    without = decision.kind in (Verdict.DISTURBANCE, Verdict.UNEXPLAINED) or nameless
    return without or decision.bursts is not None
