"""Searches one joint and decides on it.

What is known of the machine so far is ``beneath`` the search. A log that is late, and a dry
friction that creeps, come before any other physics; of a joint alone what passes fast comes after
the search, and all is decided upon it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.decide import decide
from zendsp.diagnosis.decide.fast_ripple import fine_ripples
from zendsp.diagnosis.decide.law_torque import has
from zendsp.diagnosis.decide.thresholds import LAW_ERROR
from zendsp.diagnosis.explain.faster_observer import searched
from zendsp.diagnosis.explain.given_springs import upon_given_springs
from zendsp.diagnosis.measure.evidence import compare
from zendsp.diagnosis.measure.likelihood import Scored, calibrate_joint, fit_scored
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.forward import Searcher
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.diagnosis.search.simplify import upon
from zendsp.diagnosis.search.white import is_white
from zendsp.physics.calibration.fit import Data, joint_handles
from zendsp.physics.effects import get_effect, mechanism_of
from zendsp.physics.model import Model

# gain of creep alone, as a share of the gain of what was found: with less, that was not mistaken
# for creep
CREEPS = 0.15
# standard deviations on the recordings to choose by from which a step is taken; and from which one
# may wait for another, or a friction is taken that every machine has (of a real axis with both, and
# neither in its model, each had -0.6 in 5 s)
GOES_ON, CONTRADICTED = 1.0, -1.0


class Acceptance:
    """Decides whether the search goes on with a step: it must pay for its parameters, also on the
    recordings to choose by; which must not contradict one that ``waits``. It claims nothing.
    """

    def __init__(self, choose: Data) -> None:
        self.choose = choose

    def __call__(self, before: Scored, rival: Rival, *, waits: bool = False) -> bool:
        if before.deviance - rival.value < WAIT:
            return False
        held = compare(before, rival.scored, self.choose, rival.joint)
        # every machine has friction: such a step has only not to be contradicted
        own = mechanism_of(rival.effect)
        expected = get_effect(rival.effect).common and not has(before.model, own, rival.joint)
        return held.z > (CONTRADICTED if expected or waits else GOES_ON)


def explain_joint(
    parts: Parts, beneath: Model, joint: int, jobs: int, tell: Progress
) -> tuple[JointSearch, Decision]:
    """The search of a joint, and its decision."""

    def search(parts: Parts) -> tuple[JointSearch, Decision]:
        return _search_joint(parts, beneath, joint, jobs, tell)

    return searched(search, parts, beneath, joint, jobs, tell)


def _search_joint(
    parts: Parts, beneath: Model, joint: int, jobs: int, tell: Progress
) -> tuple[JointSearch, Decision]:
    tell(Step.CALIBRATING.says(f"joint {joint}: calibrating the given model"))
    base = calibrate_joint(parts.fit, beneath, joint, jobs)
    accept = Acceptance(parts.choose)
    searcher = Searcher(parts.fit, joint, accept, jobs, tell, beneath)
    late = searcher.late_log(base)
    if late is not None:  # found before any physics is blamed
        base, beneath = late, beneath.with_terms((*beneath.terms, late.model.terms[-1]))
        searcher = Searcher(parts.fit, joint, accept, jobs, tell, beneath)
    # how a known friction acts at reversals is no missing physics, and hides what is
    soft = None if is_white(base, joint) else searcher.softened(base)
    first = soft is not None and searcher.leads(soft, base)
    search = JointSearch(joint, base) if first else searcher.search(base)
    if soft is not None and (first or not is_white(search.final, joint)):
        tell(Step.SEARCHING.says(f"joint {joint}: with a dry friction that creeps"))
        creeping = beneath.with_terms((*beneath.terms, soft.model.terms[-1]))
        again = Searcher(parts.fit, joint, accept, jobs, tell, creeping)
        other = _upon_creep(search, soft, again, jobs) or again.search(soft)
        if other.final.deviance < search.final.deviance - WAIT:
            if any(t.effect == "creep" for t in other.final.model.at(joint)):
                search, beneath = other, creeping
            else:
                search = replace(other, base=base)  # the creep is no longer needed
    search = upon_given_springs(search, beneath, searcher)
    search, beneath = _creeping_found(parts, beneath, search, searcher, tell)
    if beneath.joints == 1:  # of several, bodies and links come before what passes fast
        rippled = with_fine_ripples(parts, search, jobs)
        if rippled.fine:
            done = decided_again(parts, upon_ripples(beneath, [rippled]), rippled, jobs, tell)
            if done[1].kind in (Verdict.COMPLETE, Verdict.MISSING):
                return done
    decision = decide(parts, beneath, search, jobs, tell)
    if beneath.joints > 1:
        tell(Step.SEARCHING.says(f"joint {joint} is done, by itself: {_seems(decision)}"))
    return search, decision


def _creeping_found(
    parts: Parts, beneath: Model, first: JointSearch, searcher: Searcher, tell: Progress
) -> tuple[JointSearch, Model]:
    """The search, and the model beneath it: gone on with from a dry friction that was found, where
    that creeps; a spring, a delay or bristles beside it may only imitate it.
    """
    joint, jobs = first.joint, searcher.jobs
    laws = [(get_effect(t.effect), k) for k, s in enumerate(first.steps) for t in s.chosen.terms]
    at = next((k for law, k in laws if law.site == "dry"), None)
    creeps = any(t.effect == "creep" for t in beneath.at(joint))
    if creeps or at is None or not any(law.hidden for law, _ in laws):
        return first, beneath
    soft = searcher.softened(first.steps[at].chosen.scored)
    if soft is None:
        return first, beneath
    tell(Step.SEARCHING.says(f"joint {joint}: with the dry friction found, that creeps"))
    # held: without that friction nothing depends on it
    *terms, creep = soft.model.terms
    creeping = beneath.with_terms((*beneath.terms, creep.held()))
    base = calibrate_joint(parts.fit, creeping, joint, jobs)
    model = soft.model.with_terms((*terms, creep.held()))
    dry = fit_scored(soft.data, model, joint_handles(soft.data, model, joint), (joint,), jobs=jobs)
    step = replace(first.steps[at], chosen=replace(first.steps[at].chosen, scored=dry))
    begun = replace(first, base=base, steps=[*first.steps[:at], step], best=dry, dropped=())
    other = Searcher(parts.fit, joint, searcher.accept, jobs, tell, creeping).further(begun)
    was, now = (_dry_level(found.final.model, joint) for found in (first, other))
    # smooth over more of the motion it is a law of the speed
    turns = abs(now - was) < LAW_ERROR * was
    pays = other.final.deviance < first.final.deviance - WAIT
    return (other, creeping) if turns and pays else (first, beneath)


def _dry_level(model: Model, joint: int) -> float:
    """The level of all dry friction of a joint, N m or N."""
    laws = [(t, get_effect(t.effect)) for t in model.at(joint)]
    return sum(t.value(law.parameters[0].name) for t, law in laws if law.site == "dry")


def _upon_creep(
    first: JointSearch, soft: Scored, again: Searcher, jobs: int
) -> JointSearch | None:
    """The earlier search, fitted again upon a creeping friction, and gone on with. None where the
    creep gains so much that it may have been mistaken for what was found.
    """
    found = first.base.deviance - first.final.deviance
    if not first.base.deviance - soft.deviance < CREEPS * found:
        return None
    both = again.creeping(first.final, soft.model.terms[-1])
    return again.further(upon(first, soft, jobs, both))


def with_fine_ripples(parts: Parts, search: JointSearch, jobs: int) -> JointSearch:
    """The search with the ripples that only a fast observer sees, where it has none yet."""
    if search.fine:
        return search
    return replace(search, fine=tuple(fine_ripples(parts.fit, parts.choose, search, jobs)))


def upon_ripples(beneath: Model, searches: Iterable[JointSearch]) -> Model:
    """The model with the fast ripples of some searches that it does not have. They are held: slower
    observers know less of them than the fast one that found them.
    """
    terms = [ripple.term.held() for s in searches for ripple in s.fine]
    return beneath.with_terms((*beneath.terms, *(t for t in terms if t not in beneath.terms)))


def decided_again(
    parts: Parts, beneath: Model, first: JointSearch, jobs: int, tell: Progress
) -> tuple[JointSearch, Decision]:
    """A search fitted upon a model that knows more by now, and decided again."""
    tell(Step.ASSEMBLING.says(f"joint {first.joint}: what was found, upon what passes fast"))
    known = first.base.model.terms
    had = {t.joint for t in beneath.terms if t.effect == "creep"}
    found = (k for k, t in enumerate(known) if t.effect == "creep" and t.joint not in had)
    creep = next(found, None)
    if creep is not None:
        terms = beneath.terms
        beneath = beneath.with_terms((*terms[:creep], known[creep], *terms[creep:]))
    base = calibrate_joint(parts.fit, beneath, first.joint, jobs)
    search = upon(first, base, jobs)
    return search, decide(parts, beneath, search, jobs, tell)


def _seems(decision: Decision) -> str:
    """A sentence on the decision of one joint, before all are considered together."""
    laws = ", ".join(c.effect for c in decision.claims)
    plain = {
        Verdict.COMPLETE: "nothing seems to be missing",
        Verdict.DISTURBANCE: "something pushes it",
        Verdict.UNEXPLAINED: "something is missing that has no name",
    }
    return plain.get(decision.kind) or f"{laws} seems to be missing"
