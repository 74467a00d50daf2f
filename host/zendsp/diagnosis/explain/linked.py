"""Explains joints again where others were found to have a transmission: they feel its link."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.assemble import calibrated_machine
from zendsp.diagnosis.decide.claims import Decision, needed
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.law_torque import has
from zendsp.diagnosis.decide.pushes import unpushed
from zendsp.diagnosis.decide.thresholds import SIMULATORS_DIFFER
from zendsp.diagnosis.explain.joints import Done, Explained, explain, with_bodies
from zendsp.diagnosis.measure.curve import DRY
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.measure.windows import noise_floor, rms, window_error
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.transmission.arm_chain import springs_of
from zendsp.diagnosis.transmission.arm_motion import is_chain, may_be_chain, with_springs_at
from zendsp.diagnosis.transmission.links import divided, with_links
from zendsp.diagnosis.transmission.other_springs import (
    first_springs,
    likeliest_springs,
    needed_springs,
    with_other_spring,
)
from zendsp.physics.calibration.fit import Data
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model

# Springs and the motion that others feel are estimated in turns, until no stiffness moves by more
# than this part. A soft spring of an arm went from 107 to 104, 97.9 and 97.6 N m/rad (true: 97.2).
STIFFNESS_MOVED, IN_TURNS = 0.01, 3


@dataclass(frozen=True)
class _Machine:
    """What stays the same while links are explained."""

    measured_motion: Parts
    given: Model
    beneath: Model
    jobs: int
    tell: Progress


@dataclass(frozen=True)
class Felt:
    """An explanation in which the links of some joints are felt by the others."""

    joints: frozenset[int]
    parts: Parts
    explained: Explained

    @property
    def proposed(self) -> list[Decision]:
        """The decisions, also where the whole machine spoke against one: what others feel of a
        link may be the reason.
        """
        return [d.given_up or d for d in self.explained[1]]

    @property
    def lacking(self) -> frozenset[int]:
        """The joints that surely lack something."""
        return frozenset(d.joint for d in self.proposed if d.after.low > SIMULATORS_DIFFER)

    @property
    def is_elastic(self) -> bool:
        """Whether each of these joints has a spring without a gap, as the links felt here do."""
        return is_chain(self.parts.fit, self.explained[2].improved, self.joints)

    @property
    def is_all(self) -> bool:
        """Whether each of these joints claims its transmission, nothing else is claimed, and no
        other joint surely lacks anything.
        """
        own = _unseen(self.explained[1], "transmission") >= self.joints
        return own and self.cost[0] == len(self.joints) and self.lacking <= self.joints

    @property
    def cost(self) -> tuple[int, float]:
        """The count of claims, and the position error on the recordings to choose by."""
        return _cost(self.parts.choose, self.explained[1])


def by_all_encoders(
    measured_motion: Parts, parts: Parts, given: Model, beneath: Model, jobs: int, tell: Progress
) -> Felt | None:
    """The explanation in which others feel the links behind the springs that all encoders of an arm
    show together, before any joint is searched by itself; None where they show none.

    Upon recorded positions a joint beside a spring lacks what nobody names, and is searched for
    longest: of an arm of six joints with one, six times as long as with the link it feels.
    (A joint of which the model has no dry friction is searched first: with the model of a real arm
    without any, a spring gained 466 of the deviance, and 311 on held-out recordings.)
    """
    every = range(1, given.joints + 1)
    if given.joints < 2 or divided(beneath) or not may_be_chain(parts.fit, beneath, every):
        return None
    if not all(has(beneath, DRY, joint) for joint in every):
        return None
    tell(Step.ASSEMBLING.says("what all encoders say together about springs"))
    model = first_springs(parts.fit, parts.choose, beneath, needed(given.joints))
    if model is None:
        return None
    machine = _Machine(measured_motion, given, beneath, jobs, tell)
    felt = _settled(machine, _calibrated(machine, model), frozenset(springs_of(model)))
    return felt if felt.is_elastic else None


def _calibrated(machine: _Machine, model: Model) -> Model:
    """The model with springs, calibrated upon links that move as it says, and then with the springs
    that all encoders have beside these numbers.
    """
    springs, fit = springs_of(model), machine.measured_motion.fit
    parts = with_links(Parts(fit, fit, fit), model, springs)
    fit = with_bodies(parts, machine.beneath).fit
    others = with_springs_at(model, ()).terms
    held = model.with_terms((*others, *(spring.held() for spring in springs.values())))
    every = range(1, model.joints + 1)
    bases = [calibrate_joint(fit, held, joint, machine.jobs) for joint in every]
    known = calibrated_machine(fit, held, bases, machine.jobs)
    others = with_springs_at(known, ()).terms
    return likeliest_springs(fit, known.with_terms((*others, *springs.values())), springs)


def with_their_links(
    measured_motion: Parts,
    parts: Parts,
    given: Model,
    beneath: Model,
    begun: tuple[Explained, Felt | None],
    jobs: int,
    tell: Progress,
) -> tuple[Parts, Explained]:
    """The explanation, repeated where a joint was found to have a transmission or a sensor error.

    Other joints feel the true motion of its link, and otherwise have to explain it by something of
    their own. The joints are taken one after the other, each time the one that explains the machine
    best, as long as that claims no more and predicts no worse; a spring of another joint that it
    hid may be one claim more. A link counts, too, whose joint was given up because the whole
    machine predicted worse with it. ``begun``: the explanation, and one
    that is the first to be tried.
    """
    first, felt = begun
    machine = _Machine(measured_motion, given, beneath, jobs, tell)
    now = Felt(divided(beneath), parts, first)
    if felt is not None and (
        felt.explained is first or (_claims_all(machine, felt) and _explains(felt, now))
    ):
        now = felt
    while found := _unseen(now.proposed, "transmission", "measurement") - now.joints:
        tell(Step.ASSEMBLING.says("the links that nobody sees: what the other joints feel"))
        other = _next(machine, now, found)
        if other is None:
            break
        now = other
    explained = now.explained
    swinging = _unseen(explained[1], "transmission")
    # the motion within a measured gap depends on the last digits of its numbers
    gaps = {t.joint for t in beneath.terms[len(given.terms) :] if get_effect(t.effect).rough}
    calm = [
        unpushed(d)
        if d.kind == Verdict.DISTURBANCE and (swinging - {d.joint} or d.joint in gaps)
        else d
        for d in explained[1]
    ]
    return now.parts, (explained[0], calm, explained[2])


def _explains(felt: Felt, before: Felt) -> bool:
    """Whether an explanation claims no more than the one before, but for a spring of each joint
    whose link was not felt there, and predicts no worse.
    """
    claims = sum(len(d.claims) for d in before.proposed)
    new = len(felt.joints - before.joints)
    return felt.cost[0] < claims + new and felt.cost[1] <= before.cost[1]


def _next(machine: _Machine, now: Felt, found: frozenset[int]) -> Felt | None:
    """The explanation in which others feel the links of more joints; None where none pays.

    Of several springs all encoders together say which are needed. Where that is one, it comes
    first: another that it made up costs the search of all joints, and is tried where it fails.
    """
    needed = _needed(machine, now, found)
    if needed is not None:
        model, joints = needed
        if len(joints) > 1 and joints > now.joints:
            felt = _settled(machine, model, joints)
            if _claims_all(machine, felt) and _explains(felt, now):
                return felt
        elif len(joints) == 1 and joints <= found:
            felt = _with_link(machine, now, *joints)
            if _explains(felt, now):
                return felt
            found = found - joints
    tried = [_with_link(machine, now, joint) for joint in found]
    return min((t for t in tried if _explains(t, now)), key=lambda t: t.cost, default=None)


def _needed(
    machine: _Machine, now: Felt, found: frozenset[int]
) -> tuple[Model, frozenset[int]] | None:
    """The model with the springs of several joints that all encoders together need, and these
    joints; None where there are not several. One after the other, each spring would take up a part
    of the others.
    """
    model = now.explained[2].improved
    for decision in now.proposed:
        if decision.joint in found:
            model = _with_proposed(model, now, decision)
    joints = now.joints | found
    if len(joints) < 2 or not is_chain(now.parts.fit, model, joints):
        return None
    needed = needed_springs(now.parts.fit, model, joints)
    return None if needed is None else (needed, frozenset(springs_of(needed)))


def _with_link(machine: _Machine, now: Felt, joint: int) -> Felt:
    """The explanation in which others feel the link of one more joint. Behind springs of an arm all
    joints are explained again, with links that move as all encoders say: the springs fitted to
    accelerations that were wrong.
    """
    decision = now.proposed[joint - 1]
    model = _with_proposed(now.explained[2].improved, now, decision)
    joints = now.joints | {joint}
    if is_chain(now.parts.fit, model, joints):
        return _settled(machine, model, joints)
    parts = with_links(machine.measured_motion, model, joints, together=False)
    kept = now.explained[0][joint - 1], decision
    return Felt(joints, parts, _explain(machine, parts, {joint: kept}))


def _settled(machine: _Machine, model: Model, joints: frozenset[int]) -> Felt:
    """The explanation of an arm with springs at some joints. What a joint still lacks may be a
    spring that these hid.
    """
    alone = _in_turns(machine, model, joints)
    lacking = alone.lacking - joints
    if not lacking:
        return alone
    after = alone.explained[2].improved
    other = with_other_spring(
        alone.parts.fit,
        after if is_chain(alone.parts.fit, after, joints) else model,
        joints,
        lacking,
    )
    if other is None:
        return alone
    both = _in_turns(machine, other, joints | frozenset(springs_of(other)))
    return both if _claims_all(machine, both) and both.cost[1] < alone.cost[1] else alone


def _claims_all(machine: _Machine, felt: Felt) -> bool:
    """Whether every joint whose link is felt claims its own transmission."""
    return felt.joints <= _unseen(felt.proposed, "transmission") | divided(machine.beneath)


def _in_turns(machine: _Machine, model: Model, joints: frozenset[int]) -> Felt:
    """The explanation of an arm with springs at some joints: these, and the motion that others feel
    of them, in turns. Several springs are those of all encoders: a joint by itself fits its own to
    a motion that the others' springs made, and follows them slowly. (A gap that one of several then
    has is none of this motion: of two springs of 209 and 150 N m/rad, known within 1.5 %, one
    seemed to be a gap where both had moved by 1 %.)
    """
    parts = with_links(machine.measured_motion, model, joints)
    now = Felt(joints, parts, _explain(machine, parts, {}))
    for _ in range(IN_TURNS):
        after = _springs_after(now, model, joints)
        if after is None or not _moved(model, after, joints):
            break
        parts = with_links(machine.measured_motion, after, joints)
        kept = {
            d.joint: (s, d)
            for s, d in zip(*now.explained[:2], strict=True)
            if d.joint not in joints
        }
        other = Felt(joints, parts, _explain(machine, parts, kept))
        if other.cost > now.cost or not (len(joints) == 1 or other.is_elastic):
            break
        model, now = after, other
    return now


def _springs_after(now: Felt, model: Model, joints: frozenset[int]) -> Model | None:
    """The explained model with the springs to go on with; None where these are none. Several are
    elastic ones, though beside wrong others one may seem to stiffen.
    """
    after = now.explained[2].improved
    if not joints <= _unseen(now.proposed, "transmission"):
        return None
    kept = with_springs_at(after, set(springs_of(after)) - joints).terms
    elastic = tuple(springs_of(model)[joint] for joint in sorted(joints))
    return likeliest_springs(now.parts.fit, after.with_terms((*kept, *elastic)), joints)


def _moved(before: Model, after: Model, joints: frozenset[int]) -> bool:
    """Whether a stiffness has moved."""
    was, now = springs_of(before), springs_of(after)
    ratios = (now[j].value("stiffness") / was[j].value("stiffness") for j in joints)
    return any(abs(ratio - 1.0) > STIFFNESS_MOVED for ratio in ratios)


def _explain(machine: _Machine, parts: Parts, known: Done) -> Explained:
    m = machine
    return explain(with_bodies(parts, m.beneath), m.given, m.beneath, m.jobs, m.tell, known)


def _with_proposed(model: Model, now: Felt, decision: Decision) -> Model:
    """The improved model, with what a decision that was given up has at its joint."""
    if decision is now.explained[1][decision.joint - 1]:
        return model
    others = (t for t in model.terms if t.joint != decision.joint)
    return model.with_terms((*others, *decision.final.model.at(decision.joint)))


def _unseen(decisions: Sequence[Decision], *mechanisms: str) -> frozenset[int]:
    """The joints whose link has no sensor and for which one of some mechanisms is claimed."""
    return frozenset(
        d.joint
        for d in decisions
        if any(c.mechanism in mechanisms for c in d.claims)
        and d.joint in divided(d.final.model)
    )


def _cost(choose: Data, decisions: Sequence[Decision]) -> tuple[int, float]:
    """The count of an explanation's claims, and its position error on the recordings to choose by.
    (A likelihood would not count what its observer follows.)
    """
    away = 0.0
    for decision in decisions:
        error = rms(window_error(choose, decision.final.model, decision.joint))
        read = max(error, noise_floor(choose, decision.joint))
        away += math.log(read) if read > 0.0 else 0.0  # no data is left there
    return sum(len(d.claims) for d in decisions), away
