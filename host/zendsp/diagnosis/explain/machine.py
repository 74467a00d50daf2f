"""The findings of a whole machine: bodies, transmissions, then every joint."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.across import across_joints, friction_beside, may_be_strapped, timing
from zendsp.diagnosis.decide.assemble import Assembled, calibrated_machine
from zendsp.diagnosis.decide.beside_bodies import beside_bodies, undoubted
from zendsp.diagnosis.decide.claims import Claim, Decision
from zendsp.diagnosis.decide.contract import BEYOND, Verdict
from zendsp.diagnosis.decide.decide_bodies import (
    BodyClaim,
    as_free_as,
    decide_bodies,
    like_bodies,
    or_bodies,
    plainest,
    settled,
)
from zendsp.diagnosis.decide.fast_ripple import finding_of
from zendsp.diagnosis.decide.findings import Finding
from zendsp.diagnosis.decide.moved import bodies_wrong, count_moved
from zendsp.diagnosis.decide.thresholds import OWN_SHARE
from zendsp.diagnosis.explain.joints import (
    Done,
    Explained,
    Outnumbered,
    SearchStopped,
    explain,
    findings_at,
    not_searched,
    plainer,
    with_bodies,
)
from zendsp.diagnosis.explain.linked import by_all_encoders, with_their_links
from zendsp.diagnosis.explain.one_joint import decided_again, upon_ripples, with_fine_ripples
from zendsp.diagnosis.measure.discrepancy import discrepancy
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.measure.windows import model_error, noise_floor
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.search.bodies import BodySearch, FoundBody, find_bodies
from zendsp.diagnosis.search.body_columns import Layout
from zendsp.diagnosis.search.body_hypotheses import LIMITS
from zendsp.diagnosis.search.hypothesis import JointSearch
from zendsp.diagnosis.search.straps import Strap, strap_in_place_of
from zendsp.diagnosis.transmission.links import divided, with_links
from zendsp.diagnosis.transmission.measured import Measured, measured_transmissions, upon, with_ties
from zendsp.diagnosis.transmission.one_sensor import shown
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import TREES, Model

# where joints claim what a body could explain, a small one is considered too
BESIDE = replace(LIMITS, little=0.0, least=0.0)
# of an error: a body that calibration can absorb has the same error but for a fit's last step
ROUNDING = 1e-4
# the same where calibration moves given numbers beyond their tolerance: of nine payloads of a
# planar arm eight predicted as well as its p1 to p3, moved by up to 150 %, one 0.01 % worse
AS_GOOD = 0.001


@dataclass(frozen=True)
class Found:
    """The findings of a machine before they are put into words: bodies, transmissions, joints.

    ``bare``: the recordings without inertias from inverse dynamics. ``beneath``: the given model
    with the bodies and transmissions with which the joints were searched. ``without``: where it is
    known, the explanation of the joints without a body.
    """

    parts: Parts
    bare: Parts
    beneath: Model
    bodies: BodySearch
    measured: list[Measured]
    searches: list[JointSearch]
    decisions: list[Decision]
    whole: Assembled
    claims: tuple[BodyClaim, ...]
    fine: tuple[Finding, ...] = ()  # fast ripples
    loads: tuple[Finding, ...] = ()  # of some of the recordings only
    without: Explained | None = None

    @property
    def explained(self) -> Explained:
        """The explanation of its joints."""
        return self.searches, self.decisions, self.whole

    def explained_by(self, other: Explained) -> Found:
        """The same findings with another explanation of the joints."""
        return replace(self, searches=other[0], decisions=other[1], whole=other[2])


class Stopped(KeyboardInterrupt):
    """Raised by Ctrl-C, with what was ``found`` until then."""

    def __init__(self, found: Found) -> None:
        super().__init__()
        self.found = found


@contextmanager
def kept(found: Callable[[], Found]) -> Iterator[None]:
    """After Ctrl-C, fall back to what was found before the current attempt."""
    try:
        yield
    except KeyboardInterrupt:
        raise Stopped(found()) from None


def find_once(measured_motion: Parts, given: Model, jobs: int, tell: Progress) -> Found:
    """The findings: bodies first, then measured transmissions, then every joint; repeated where one
    changes what the others have to explain, and without bodies that make untouched recordings
    worse.
    """
    tell(Step.CALIBRATING.says("calibrating the given model"))
    parts = with_links(measured_motion, given, divided(given))
    bodies = find_bodies(parts.fit, parts.choose, given, jobs, tell)
    found = _beneath(bodies, measured_motion, parts, given, jobs, tell)
    with kept(lambda: found):
        return _settled_once(found, measured_motion, parts, given, jobs, tell)


def _settled_once(
    found: Found, measured_motion: Parts, parts: Parts, given: Model, jobs: int, tell: Progress
) -> Found:
    """The findings, with bodies that they hide or that replace them, all estimated together."""
    bodies = found.bodies
    same = not found.measured and found.bare.fit.records is parts.fit.records
    without = found.explained if same and not bodies.found else None
    # a delay or friction hides a body
    beside = timing(found.decisions) or friction_beside(found.decisions)
    if beside and not found.claims:
        bodies = find_bodies(parts.fit, parts.choose, given, jobs, tell, BESIDE, beside)
        if bodies.found:
            again = _beneath(bodies, measured_motion, parts, given, jobs, tell, without)
            found = again if again.claims else found
        elif bodies.strap is not None:
            found = replace(found, bodies=replace(found.bodies, strap=bodies.strap))
    own = _for_the_joints(bodies, found)
    if own is not None:
        again = _beneath(bodies.taken(own), measured_motion, parts, given, jobs, tell, without)
        found = again if _replaces(again, found, given) else found
    if given.kind in TREES and _all_weigh(found.decisions):
        found = _or_plain_body(found, measured_motion, parts, given, jobs, tell)
    finished = _finished(found, given, jobs, tell)
    if finished.claims and _predicts_worse(finished, given):
        none = replace(bodies, model=given, found=())
        found = _beneath(none, measured_motion, parts, given, jobs, tell)
        finished = _finished(found, given, jobs, tell)
    return finished


def _or_plain_body(
    found: Found, measured_motion: Parts, parts: Parts, given: Model, jobs: int, tell: Progress
) -> Found:
    """The findings, or those with one body in place of them all, where that takes fewer claims and
    given numbers that calibration moved. It is looked for with the rotors and constants that the
    model states: along a slide a payload is an inertia and a constant, and a weaker drive with less
    friction of every kind is the same, exactly.
    """
    search = find_bodies(parts.fit, parts.choose, given, jobs, tell, replace(LIMITS, own=False))
    body = next(iter((*search.found, *(b for b, _ in search.instead))), None)
    if body is None:
        return found
    none = replace(found.bodies, model=given, found=())
    again = _beneath(none.taken(body), measured_motion, parts, given, jobs, tell)

    def cost(f: Found) -> int:
        claims = len(f.claims) + sum(len(d.claims) for d in f.decisions)
        nameless = sum(d.kind == Verdict.UNEXPLAINED for d in f.decisions)
        return claims + nameless + count_moved(given, f.whole.improved)

    return again if _replaces(again, found, given) and cost(again) < cost(found) else found


def _all_weigh(decisions: Sequence[Decision]) -> bool:
    """Whether joints claim something, and all of that may be the torque of a body."""
    claims = [c for d in decisions for c in d.claims]
    return bool(claims) and all(map(_of_a_body, claims))


def _predicts_worse(found: Found, given: Model) -> bool:
    """Whether the findings predict worse than calibration alone. Where that takes up a body by
    numbers that it moves beyond their tolerance, they may be a little worse: it explains the same
    with more free numbers, and not more simply.
    """
    test, whole = found.parts.test, found.whole
    improved, calibrated = (model_error(test, m) for m in (whole.improved, whole.calibrated))
    far = bodies_wrong(given, whole.calibrated) >= len(found.claims)
    return improved > (1.0 + (AS_GOOD if far else ROUNDING)) * calibrated


def _for_the_joints(bodies: BodySearch, found: Found) -> FoundBody | None:
    """The findings with a body in place of the claims of joints: of one joint, where it explains as
    much, or of several, some of which may lack torque without a name. Constants are free in the
    search for bodies, and can hide one.
    """
    if found.claims:
        return None
    for body, joint in bodies.instead:
        if _may_weigh(found.decisions[joint - 1]):
            return body
    claimed = sum(_weighs(d) for d in found.decisions)
    unnamed = sum(d.kind == Verdict.UNEXPLAINED for d in found.decisions)
    several = claimed > 0 and claimed + unnamed > 1
    return bodies.small if several and not bodies.found else None


def _replaces(body: Found, joints: Found, given: Model) -> bool:
    """Whether a claimed body stands in place of what the joints that bear it claim: it predicts as
    well but for a thousandth of what they explain, or as well as the sensor lets anyone judge; and
    beside claims that are no torque of a body there are fewer findings.

    A body that explains as much as a joint's fault need not be what the joint before it lacks: a
    gain of 0.9 beside a balancer was a payload, with which 20 % stayed unexplained there.
    """
    if not body.claims:
        return False
    test, bear = joints.bare.test, {joint for c in body.claims for joint in c.sizes}
    if any(d.claims and d.joint in bear and not _weighs(d) for d in joints.decisions):
        more = 1 - len(body.claims)
        return plainer(test, given, body.explained, joints.explained, more)
    models = (body.whole.improved, joints.whole.improved, joints.whole.calibrated)
    error, other, before = (model_error(test, m) for m in models)
    slack = AS_GOOD * max(other, before - other)  # of the error, or of what the joints explain
    return error <= max(other + slack, BEYOND * noise_floor(test))


def _may_weigh(decision: Decision) -> bool:
    """Whether the largest claim of a joint may be the torque of a body, or the joint lacks torque
    that no claim explains. What else it claims may be what such a law leaves of the body: a forearm
    12 % heavier was a gain, and beside it an eccentric encoder.
    """
    if not decision.claims:
        return decision.kind == Verdict.UNEXPLAINED
    return _of_a_body(max(decision.claims, key=lambda c: c.size))


def _weighs(decision: Decision) -> bool:
    """Whether all claims of a joint may be the torque of a body."""
    return bool(decision.claims) and all(_of_a_body(c) for c in decision.claims)


def _of_a_body(claim: Claim) -> bool:
    """Whether a claim of a joint may be the torque of a body."""
    inert = claim.mechanism in ("position_torque", "inertia")
    return inert or claim.is_constant or claim.term.effect in like_bodies()


def _lacks_less(felt: Parts, bare: Parts, model: Model) -> bool:
    """Whether some joint surely lacks less torque with links that others feel, and none more."""
    joints = range(1, model.joints + 1)
    each = [[discrepancy(p.choose, model, joint) for joint in joints] for p in (felt, bare)]
    pairs = list(zip(*each, strict=True))
    return any(f.high < b.low for f, b in pairs) and not any(f.low > b.high for f, b in pairs)


def _beneath(
    bodies: BodySearch,
    measured_motion: Parts,
    parts: Parts,
    given: Model,
    jobs: int,
    tell: Progress,
    without: Explained | None = None,
) -> Found:
    """The findings with some bodies, or with those of them that can be claimed."""
    records = parts.fit.records
    measured = measured_transmissions(parts, bodies.model, jobs)
    measured_motion, bare = with_ties(measured_motion, measured), with_ties(parts, measured)
    beneath = upon(bodies.model, measured)
    if (behind := divided(beneath)) - divided(given):  # others feel the links of measured ones too
        felt = with_links(measured_motion, beneath, behind)
        bare = felt if _lacks_less(felt, bare, beneath) else bare
    parts = with_bodies(bare, beneath)

    def known_by(explained: Explained) -> Found:
        claims = decide_bodies(parts, bodies, explained[1], jobs)
        known = without if not measured and bare.fit.records is records else None
        return Found(
            parts, bare, beneath, bodies, measured, *explained, claims, without=known
        )

    def known_of(done: Done) -> Found:
        rest = (j for j in range(1, given.joints + 1) if j not in done)
        every = {**done, **{j: not_searched(parts, beneath, j, jobs) for j in rest}}
        return known_by(explain(parts, given, beneath, jobs, tell, every))

    try:
        sprung = by_all_encoders(measured_motion, parts, given, beneath, jobs, tell)
        if sprung is not None and sprung.is_all:
            explained = sprung.explained
        else:
            explained = explain(parts, given, beneath, jobs, tell)
    except SearchStopped as stop:
        raise Stopped(known_of(stop.done)) from None
    with kept(lambda: known_by(explained)):
        linked, again = with_their_links(
            measured_motion, bare, given, beneath, (explained, sprung), jobs, tell
        )
        if linked is not bare:
            bare, parts = linked, with_bodies(linked, beneath)
        explained = again
        return _claimed_of(known_by(explained), given, jobs, tell)


def _claimed_of(found: Found, given: Model, jobs: int, tell: Progress) -> Found:
    """The findings with the claimed ones of the bodies."""
    plain = upon(given, found.measured)
    bare, bodies, claims, beneath = found.bare, found.bodies, found.claims, found.beneath
    if len(claims) < len(bodies.found):  # the joints have to explain what is no body
        with_all = found.explained
        beneath = plain.with_terms((*plain.terms, *(c.found.term for c in claims)))
        parts = with_bodies(bare, beneath)
        explained = found.without if not claims else None
        explained = explained or explain(parts, given, beneath, jobs, tell)
        found = replace(found, parts=parts, beneath=beneath).explained_by(explained)
        return found if claims else _one_body(found, with_all, given, jobs, tell)
    if any(_is_corrected(claims, d) for d in found.decisions):
        # a body that the joints have to correct may be none: the simpler explanation wins
        parts = with_bodies(bare, plain)
        most = findings_at(bare.test, given, found.explained) + len(claims)
        try:
            other = explain(parts, given, plain, jobs, tell, most=most)
        except Outnumbered:
            return found
        if plainer(bare.test, given, other, found.explained, len(claims)):
            found = replace(found, parts=parts, beneath=plain, claims=()).explained_by(other)
    return found


def _is_corrected(claims: Sequence[BodyClaim], decision: Decision) -> bool:
    """Whether a joint claims an inertia that is no small part of what the bodies do there."""
    felt = max((c.sizes.get(decision.joint, 0.0) for c in claims), default=math.inf)
    return any(
        c.mechanism == "inertia" and c.size**2 >= OWN_SHARE * felt**2 for c in decision.claims
    )


def _one_body(
    apart: Found, explained: Explained, given: Model, jobs: int, tell: Progress
) -> Found:
    """The findings with the one body that explains most, where the joints ``apart`` have more
    findings without it and predict no better. Each joint can mistake its part of a body for a wrong
    number or a function of the position, so that none misses the body. Or with the first, where
    it is claimed by itself: a second one that is none hid it. ``explained``: the findings with all
    proposed bodies.
    """
    test, proposed = apart.bare.test, apart.bodies.found
    without = apart.explained
    if findings_at(test, given, without) < 2:  # a body is one finding too
        return apart
    beneath = apart.beneath.with_terms((*apart.beneath.terms, proposed[0].term))
    parts = with_bodies(apart.bare, beneath)
    if len(proposed) > 1:
        explained = explain(parts, given, beneath, jobs, tell)
        first = replace(apart.bodies, found=proposed[:1])
        if claims := decide_bodies(parts, first, explained[1], jobs):
            return Found(
                parts, apart.bare, beneath, apart.bodies, apart.measured, *explained, claims
            )
    if not plainer(test, given, explained, without, -1):
        return apart
    claim = plainest(parts, proposed[0], explained[1], jobs)
    return Found(
        parts, apart.bare, beneath, apart.bodies, apart.measured, *explained, (claim,)
    )


def _finished(found: Found, given: Model, jobs: int, tell: Progress) -> Found:
    """The findings with fast ripples, and bodies and joints estimated together."""
    parts, bare, beneath, claims = found.parts, found.bare, found.beneath, found.claims
    searches, decisions, whole = found.searches, found.decisions, found.whole
    tell(Step.ASSEMBLING.says("looking for what passes fast"))
    rippled = {
        s.joint: with_fine_ripples(parts, s, jobs)
        for s, d in zip(searches, decisions, strict=True)
        if d.kind in (Verdict.COMPLETE, Verdict.MISSING)
    }
    # a missing ripple may be mistaken for other effects: decide again beside it
    if any(s.fine for s in rippled.values()):
        beneath = upon_ripples(beneath, rippled.values())
        done = {
            s.joint: decided_again(parts, beneath, rippled[s.joint], jobs, tell)
            if s.joint in rippled and rippled[s.joint].fine and not s.fine
            else (s, d)
            for s, d in zip(searches, decisions, strict=True)
        }
        searches, decisions, whole = explain(parts, given, beneath, jobs, tell, done)
    if claims:
        claims, improved = settled(parts, given, claims, whole.improved, decisions, jobs)
        if any("calibration" in c.found.indistinguishable for c in claims):
            improved = _calibrated_beside(parts.fit, given, improved, jobs)
        whole = replace(whole, improved=improved)
        decisions = undoubted(claims, beside_bodies(claims, decisions, parts.test), parts)
    else:
        decisions = or_bodies(found.bodies, decisions)
    strap = found.bodies.strap or _strap_of(found, decisions, jobs)
    if claims or any(m.terms for m in found.measured):  # these are findings, not calibration
        own = upon(given, [m.calibrating(given) for m in found.measured])
        bases = [
            calibrate_joint(bare.fit, own, joint, jobs) for joint in range(1, given.joints + 1)
        ]
        calibrated = calibrated_machine(bare.fit, own, bases, jobs)
        whole = replace(whole, calibrated=calibrated)
    return replace(
        found,
        searches=searches,
        decisions=shown(parts, found.bodies.model, across_joints(decisions, strap)),
        whole=whole,
        claims=claims,
        fine=tuple(
            finding_of(r, given.joint_kind(s.joint)) for s in searches for r in s.fine
        ),
    )


def _strap_of(found: Found, decisions: Sequence[Decision], jobs: int) -> Strap | None:
    """A force between links where joints claim what may be sections through its potential."""
    fit, choose, model = found.parts.fit, found.parts.choose, found.bodies.model
    links = fit.records[0][0].links
    if links is None or len(links.bodies) < 2 or not may_be_strapped(decisions):
        return None
    bodies = [e.hypothesis for e in found.bodies.tried if e.hypothesis.of_bodies][:1]
    layout = Layout(model, links)
    return strap_in_place_of(bodies, (fit, choose), layout, LIMITS, jobs, alone=True)


def _calibrated_beside(fit: Data, given: Model, improved: Model, jobs: int) -> Model:
    """The findings with the improved model calibrated beside its bodies. Its own numbers, which
    could have absorbed a body, were held during the search for bodies.
    """
    free = as_free_as(given, improved)
    bases = [calibrate_joint(fit, free, joint, jobs) for joint in range(1, given.joints + 1)]
    return calibrated_machine(fit, free, bases, jobs)
