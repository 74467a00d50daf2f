"""The decision about bodies, by the cost of taking a body away on untouched recordings, as for the
mechanisms of one joint.

The search of the joints went on with the bodies in the model. Here each body is taken away and
everything else at the joints that bear it is fitted again. The joints' evidence for the one body
adds up. A body is claimed where most of its torque acts at joints that miss more of it than stays
unexplained there.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Claim, Decision, needed, shared
from zendsp.diagnosis.decide.confidence import sure_by
from zendsp.diagnosis.decide.contract import Further, Rejected, Verdict
from zendsp.diagnosis.decide.findings import Estimate, Finding, number, percent
from zendsp.diagnosis.decide.pieces import log_e_value
from zendsp.diagnosis.decide.thresholds import PLAIN
from zendsp.diagnosis.measure.discrepancy import difference
from zendsp.diagnosis.measure.evidence import compare
from zendsp.diagnosis.measure.likelihood import fit_scored
from zendsp.diagnosis.measure.significance import INTEGRATION_ERROR
from zendsp.diagnosis.measure.windows import model_error
from zendsp.diagnosis.search.bodies import BodySearch, FoundBody
from zendsp.diagnosis.search.body_columns import Layout
from zendsp.diagnosis.search.body_explain import Explained, seen, tied
from zendsp.diagnosis.search.body_hypotheses import COM, LIMITS
from zendsp.diagnosis.search.body_numbers import agreed, gain_known, refined, stated, unsure
from zendsp.physics.calibration.fit import joint_handles
from zendsp.physics.effects import library
from zendsp.physics.model import Model
from zendsp.physics.robots.bodies import Links

# of a body's squared torque over all joints: this part must act where it exceeds what is left
LARGER_THAN_LEFT = 0.5
MOSTLY = 0.5  # of the variance of a body's number: the torque gains make its uncertainty
UNSTATED = "since [actuator] gain states no std"
REJECTED = 4  # so many of its rivals are reported
# rivals that are no effects, in words
IN_WORDS = {
    "gravity_scale": "another strength of gravity",
    "calibration": "other values of the model's own free numbers",
}


@dataclass(frozen=True)
class BodyClaim:
    """A claimed body. ``sizes``: its RMS torque at each joint, as a part of the joint's. ``gain``:
    its deviance on the test recordings.
    """

    found: FoundBody
    sizes: dict[int, float]
    gain: float
    confidence: float

    @property
    def square(self) -> float:
        """Its part in the explainable mismatch: the sum of its squared sizes, as for the joints'
        discrepancies.
        """
        return sum(s**2 for s in self.sizes.values())


def decide_bodies(
    parts: Parts, search: BodySearch, decisions: Sequence[Decision], jobs: int
) -> tuple[BodyClaim, ...]:
    """The proposed bodies that are claimed.

    Parameters
    ----------
    parts : Parts
        Recordings to fit to, to choose by, and to test on.
    search : BodySearch
        The proposals, which the models of the decisions contain.
    decisions : sequence of Decision
        The decisions about the joints, with the bodies in the model.
    jobs : int
        Threads.

    Returns
    -------
    tuple of BodyClaim
        Those whose removal costs most first.
    """
    links = parts.fit.records[0][0].links
    claims = [
        c for f in search.found if (c := _decided(parts, f, decisions, links, jobs)) is not None
    ]
    return tuple(sorted(claims, key=lambda c: -c.gain))


@dataclass(frozen=True)
class Heard:
    """The evidence of one joint for a body: its size and the unexplained torque there, as parts of
    the RMS torque; the log e-value, and the evidence in standard deviations.
    """

    size: float
    left: float
    log_e: float
    z: float


def borne(heard: Sequence[Heard], least: float) -> float | None:
    """The ratio of a body's size to what stays unexplained at the joints that bear it.

    A single joint need not be sure, since the evidence for the one body adds up. None where the sum
    is below ``least``, or most of the body's torque acts at joints that do not miss it.
    """
    bear = [h for h in heard if h.log_e > 0.0 and h.z > PLAIN and h.size > h.left]
    total, here = (sum(h.size**2 for h in part) for part in (heard, bear))
    if here <= LARGER_THAN_LEFT * total or sum(h.log_e for h in heard) <= least:
        return None
    return math.sqrt(here / max(sum(h.left**2 for h in bear), 1e-18))


def _decided(
    parts: Parts, found: FoundBody, decisions: Sequence[Decision], links: Links | None, jobs: int
) -> BodyClaim | None:
    if unsure(found.explained):
        return None
    heard, gain = _heard(parts, found, decisions, links, jobs)
    ratio = borne(list(heard.values()), needed(len(decisions)))
    return None if ratio is None else _claim(found, heard, gain, ratio)


def plainest(
    parts: Parts, found: FoundBody, decisions: Sequence[Decision], jobs: int
) -> BodyClaim:
    """The claim of a body that stands in the place of several findings at the joints.

    The cost of its removal is measured with the rotor inertias held as the model states them, so
    that calibration cannot absorb the body.
    """
    links = parts.fit.records[0][0].links
    heard, gain = _heard(parts, found, decisions, links, jobs, hold=("inertia",))
    left = sum(h.left**2 for h in heard.values())
    ratio = math.sqrt(sum(h.size**2 for h in heard.values()) / max(left, 1e-18))
    return _claim(found, heard, gain, ratio)


def _heard(
    parts: Parts,
    found: FoundBody,
    decisions: Sequence[Decision],
    links: Links | None,
    jobs: int,
    hold: Collection[str] = (),
) -> tuple[dict[int, Heard], float]:
    """The evidence for a body at the joints that feel it, and the deviance that its removal costs.
    Terms of the effects in ``hold`` keep their numbers.
    """
    heard: dict[int, Heard] = {}
    gain = 0.0
    for decision in decisions:
        joint, final = decision.joint, decision.final
        if not feels(found, joint, links):
            continue
        model = final.model.with_terms(
            tuple(
                t.held() if t.effect in hold else t for t in final.model.terms if t != found.term
            )
        )
        data = replace(final.data, records=parts.fit.records)
        handles = joint_handles(data, model, joint)
        without = fit_scored(data, model, handles, (joint,), jobs=jobs, rounds=2, iterations=8)
        held = compare(without, final, parts.test, joint)
        size = difference(parts.test, without.model, final.model, joint)
        log_e = log_e_value(held, without, final, parts.test, joint)
        heard[joint] = Heard(size, decision.after.value, log_e, held.z)
        gain += held.gain
    return heard, gain


def _claim(found: FoundBody, heard: dict[int, Heard], gain: float, ratio: float) -> BodyClaim:
    """The claim of a body; ``ratio`` says how much larger it is than what stays unexplained."""
    sure = sure_by(ratio, 1.0)
    if found.indistinguishable:
        sure *= shared(len(found.indistinguishable))
    sizes = {joint: h.size for joint, h in heard.items()}
    return BodyClaim(found, sizes, gain, max(0.05, sure))


def like_bodies() -> frozenset[str]:
    """The effects of single joints that a body may be mistaken for: its ``rivals``."""
    return frozenset(r for e in library().values() if e.site == "body" for r in e.rivals)


def or_bodies(search: BodySearch, decisions: Sequence[Decision]) -> list[Decision]:
    """The decisions where no body is claimed. A joint's claim that resembles a body is less sure
    where a body explains all joints together as well as this effect does; also where a body
    explained as much as the joint's own fault, and another joint lacks torque without a name,
    beside which neither can be judged.
    """
    gaps = {d.joint for d in decisions if d.kind == Verdict.UNEXPLAINED}
    asked = {joint: body for body, joint in search.instead if gaps - {joint}}

    def told(c: Claim, joint: int) -> Claim:
        nameless = c.effect == "unknown" and c.mechanism == "position_torque"
        if not nameless and c.effect not in like_bodies():
            return c
        own = [h for h in search.tried if h.hypothesis.effect == c.effect]
        own = [e for e in own if e.hypothesis.joint in (0, joint)]
        bodies = (e for e in search.tried if e.hypothesis.of_bodies and seen(e))
        names = dict.fromkeys(
            e.hypothesis.effect for e in bodies if own and all(tied(e, o) for o in own)
        )
        if joint in asked:
            names[asked[joint].term.effect] = None
        most = min(c.most, shared(len(names)))
        return replace(c, same=tuple(dict.fromkeys((*c.same, *names))), most=most)

    return [replace(d, claims=tuple(told(c, d.joint) for c in d.claims)) for d in decisions]


def feels(found: FoundBody, joint: int, links: Links | None) -> bool:
    """Whether a joint (1-based) feels the body."""
    if found.term.effect == "base_tilt" or links is None:
        return True
    return links.moves(joint - 1, found.term.joint - 1)


def as_free_as(given: Model, model: Model) -> Model:
    """A model whose mechanism's numbers are as free, and known as well, as in the given one."""
    mechanism = {
        key: tuple(
            replace(q, free=was.free, std=was.std)
            for q, was in zip(items, given.mechanism[key], strict=True)
        )
        for key, items in model.mechanism.items()
    }
    return replace(model, mechanism=mechanism)


def settled(
    parts: Parts,
    given: Model,
    claims: Sequence[BodyClaim],
    improved: Model,
    decisions: Sequence[Decision],
    jobs: int,
) -> tuple[tuple[BodyClaim, ...], Model]:
    """The claims with their numbers estimated again beside all findings of the joints, and the
    model with these. A spring or a gain was fitted beside the proposed body and absorbed its error,
    so at such a joint functions of the position stay free. Numbers that predict worse are not
    taken: in slow motion these functions are all that a body does.
    """
    loose = {
        d.joint
        for d in decisions
        for c in d.claims
        if c.mechanism in ("position_torque", "actuator")
    }
    links = parts.fit.records[0][0].links
    if links is None:
        return tuple(claims), improved
    out = []
    for claim in claims:
        term = claim.found.term
        rest = improved.with_terms(tuple(t for t in improved.terms if t != term))
        layout = Layout(as_free_as(given, rest), links)
        # the test recordings must stay untouched
        again = (refined if parts.choose is parts.test else agreed)(
            parts.fit,
            parts.choose,
            layout,
            claim.found.explained,
            replace(LIMITS, rounds=2, bandwidth=claim.found.bandwidth),
            jobs,
            claim.found.aside | loose,
        )
        new = stated(layout, again)
        other = improved.with_terms(tuple(new if t == term else t for t in improved.terms))
        before, after = (model_error(parts.choose, m) for m in (improved, other))
        if after <= before:
            improved = other
            claim = replace(claim, found=replace(claim.found, term=new, explained=again))
        out.append(claim)
    return tuple(out), improved


def body_finding(claim: BodyClaim, everything: float, given: Model) -> Finding:
    """The finding of a claimed body; ``everything`` is the explainable mismatch of which it is a
    part. ``given``: the model.
    """
    found = claim.found
    h, term = found.explained.hypothesis, found.term
    values = {}
    for key, value, std in zip(h.free, found.explained.values, found.explained.std, strict=True):
        unit = (
            "kg"
            if key == "mass"
            else "rad" if key.startswith("angle") else "kg m^2" if key == "inertia" else "m"
        )
        scale = abs(value) if key in ("mass", "inertia") else max(abs(value), 0.1)
        values[key] = Estimate(float(value), float(np.hypot(std, INTEGRATION_ERROR * scale)), unit)
    text = _sentence(found, values) + _why_unsure(found.explained, given)
    if found.indistinguishable:
        others = ", ".join(IN_WORDS.get(name, name) for name in found.indistinguishable)
        text += f" This recording cannot tell it from {others}."
    share = min(1.0, claim.square / max(everything, 1e-300))
    numbers: Further = {"body": found.body} if found.body else {}
    law = {term.effect: 1.0}
    return Finding(
        term.effect,
        term.joint,
        values,
        claim.confidence,
        share,
        _effects(found.indistinguishable, term.effect),
        (),
        text,
        numbers,
        "inertia",
        law,
    )


def _why_unsure(explained: Explained, given: Model) -> str:
    """A sentence where most of a body's uncertainty is that of the gains of the drives, or of an
    inertia of its own.
    """

    def most_of_it(part: npt.NDArray[np.float64] | None) -> bool:
        return part is not None and bool(np.any(part**2 > MOSTLY * explained.std**2))

    if most_of_it(explained.of_inertia):
        return " Most of its ± is for an inertia about its own centre, which nothing here shows."
    if not most_of_it(explained.of_gain):
        return ""
    stated = "as [actuator] gain states" if given.actuator.gain_known else UNSTATED
    most = f"{percent(gain_known(given))} %"
    return f" Most of its ± comes from the torque gains of the drives ({most}, {stated})."


def _sentence(found: FoundBody, values: dict[str, Estimate]) -> str:
    effect, body = found.term.effect, found.body
    name = body if body.lower().startswith("link") else f"link {body}"
    link = f"{name[0].upper()}{name[1:]} (joint {found.term.joint})"
    known = [key for key in COM if key in values]
    centre = ", ".join(
        (f"{key[-1]} = " if len(known) == 2 else "") + number(values[key]).removesuffix(" m")
        for key in known
    )
    if effect == "payload":
        where = f"{centre} m along it" if len(known) == 1 else f"({centre}) m"
        at = f", with its centre at {where} in the link's frame" if known else ""
        return f"{link} carries {number(values['mass'])} that the model lacks{at}."
    if effect == "base_tilt":
        turns = " and ".join(
            f"by {number(values[key])} about the base's {key[-1]} axis"
            for key in ("angle_x", "angle_y")
            if key in values
        )
        return (
            f"Gravity does not point where the model says: it is turned {turns}, as on a tilted"
            " base."
        )
    if "mass" in values:
        return (
            f"{link} has another mass than the model says: the difference is"
            f" {number(values['mass'])}."
        )
    return (
        f"{link} has its centre of mass elsewhere than the model says: the difference is"
        f" ({centre}) m."
    )


def rejected_bodies(search: BodySearch, claims: Sequence[BodyClaim]) -> list[Rejected]:
    """The proposed bodies that are not claimed, and the rivals of those that are. Where none was
    proposed: the best hypotheses that were tried.
    """
    claimed = {(c.found.term.effect, c.found.term.joint) for c in claims}
    refused = [f.explained for f in search.found if (f.term.effect, f.term.joint) not in claimed]
    if not search.found:
        refused = [e for e in search.tried if e.hypothesis.of_bodies and e.gain > 0][:REJECTED]
    why = "is not what is missing, on the recordings held out"
    out = [
        Rejected(e.hypothesis.effect, max(e.hypothesis.joint, 1), why, -abs(e.gain))
        for e in refused
    ]
    for claim in claims:
        best = claim.found.explained.gain
        for e in claim.found.rejected[:REJECTED]:
            part = 100 * min(0.99, float(np.clip(e.share, 0, 1).mean()))
            if e.hypothesis.effect != "unknown":
                why = f"explains {part:.0f} % of it ({e.hypothesis.name})"
                out.append(
                    Rejected(
                        e.hypothesis.effect, max(e.hypothesis.joint, 1), why, 0.5 * (e.gain - best)
                    )
                )
    return out


def _effects(words: Sequence[str], own: str) -> tuple[str, ...]:
    """The effect names of hypotheses in words ("payload of link3"), each once; the same effect of
    another link with its link. The sentence has all links, and the rivals that are no effects.
    """
    named = ((w, w.split(" of ")[0]) for w in words)
    effects = (w if effect == own else effect for w, effect in named if effect in library())
    strength = ("gravity",) if "gravity_scale" in words else ()
    return tuple(dict.fromkeys((*effects, *strength)))
