"""The search of a joint under an observer that holds its model to the motion.

Friction that falls with the speed drives a model away from the motion. An observer slower than that
shows the instability in place of a torque, so such a joint is searched under a faster one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.measure.discrepancy import runs_away
from zendsp.diagnosis.measure.likelihood import FASTEST, calibrate_joint, fastest
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.diagnosis.search.short_fits import WAIT
from zendsp.physics.effects import get_effect, library
from zendsp.physics.model import Model

# times the usual fastest observer: friction that fell at 119 /s was a disturbance of 0.85 under 64
# rad/s, and is found to four digits under 256
FASTER = 4.0
WORTHWHILE = 2.0  # the same, at least: bandwidths are tuned by halving and doubling
Found = tuple[JointSearch, Decision]


def searched(
    search: Callable[[Parts], Found],
    parts: Parts,
    beneath: Model,
    joint: int,
    jobs: int,
    tell: Progress,
) -> Found:
    """The search of a joint and its decision, made by ``search`` from recordings with the usual
    observers; with a faster one where the model's friction falls faster than those follow, or
    where such a friction explains what else has no name.
    """
    fast = faster(parts, joint)
    if fast is None:
        return search(parts)
    if runs_away(parts.fit, beneath, joint) > FASTEST:
        return search(fast)
    found, decision = search(parts)
    if decision.kind not in (Verdict.UNEXPLAINED, Verdict.DISTURBANCE):
        return found, decision
    tell(Step.SEARCHING.says(f"joint {joint}: whether its friction falls fast with the speed"))
    if not _falls_fast(fast, found, joint, jobs, tell):
        return found, decision
    other = search(fast)
    return other if other[1].kind == Verdict.MISSING else (found, decision)


def faster(parts: Parts, joint: int) -> Parts | None:
    """The recordings with a faster observer on one joint; None where they are too slow for one."""
    band = fastest(parts.fit, FASTER * FASTEST)
    if band < WORTHWHILE * FASTEST:
        return None
    moved = {id(part): part.at_bandwidth(joint, band) for part in parts.each}
    fit, choose, test = (moved[id(part)] for part in (parts.fit, parts.choose, parts.test))
    return replace(parts, fit=fit, choose=choose, test=test)


def _falls_fast(fast: Parts, found: JointSearch, joint: int, jobs: int, tell: Progress) -> bool:
    """Whether friction that falls faster than the usual observers follow makes the recordings
    likelier than all that was found.
    """
    laws = frozenset(name for name, effect in library().items() if effect.drops is not None)
    # what was found may be this friction in disguise; but there has to be one that can fall
    known = any(get_effect(t.effect).site == "dry" for t in found.base.model.at(joint))
    model = (found.base if known else found.final).model
    base = calibrate_joint(fast.fit, model, joint, jobs)
    rivals = Rounds(fast.fit, joint, jobs, tell).stand_ins(base, laws)
    best = min(rivals, key=lambda r: r.value, default=None)
    return (
        best is not None
        and best.value < min(base.deviance, found.final.deviance) - WAIT
        and runs_away(fast.fit, best.scored.model, joint) > FASTEST
    )
