"""Compares one answer with one sealed truth: by mechanism, by law, and by what is named beyond the
truth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from zendsp.proof.answer import Answer, Finding
from zendsp.proof.mechanisms import BODILY, MECHANISM, NEEDLESS, SIZE, mechanism_of
from zendsp.proof.truth import Effect, Place, Truth

# nothing to divide an error by: angles, and places that may lie near zero
ANGLES = ("phase", "angle")
PLACES = ("neutral",)
Z90 = 1.645
# a finding stated at least so sure that a wrong one misleads
SURE = 0.8
# error of the improved model over that of the calibrated one, above which untouched data are worse
WORSE = 1.02

# of the RMS torque: what a refit leaves of a foreign torque, below which "complete" is no wrong
# answer
FAINTEST = 0.01


@dataclass(frozen=True)
class Judgement:
    """How one answer stands to the truth; None where the question does not apply."""

    case: str
    machine: str
    kind: str
    effects: tuple[str, ...]
    size: float
    detectable: bool
    reality: str = "own"
    seed: int = 0  # of the draw: a case that is given in two forms has it twice
    given: str = ""  # "mjcf": the form of the given model where it is not the usual one
    first: str = ""  # the first finding: name, and its body or joint
    mechanism: bool | None = None  # the first finding's mechanism acts, on that joint or body
    law: bool | None = None  # and the law that it names is right
    strict: bool | None = None  # single effect: the very name first, on the right joint
    named: bool | None = None  # single effect: first finding is right, or right set
    both: bool | None = None  # several effects: all of them lead the findings
    replaced: bool | None = None  # the wrong law named as replaced, and the right ones found
    alarm: bool | None = None  # complete machines: something was claimed
    refused: bool | None = None  # foreign torque: no law claimed
    missed: bool | None = (
        None  # called complete though larger than what the report says it would have seen
    )
    worse: bool | None = None  # the findings make an untouched recording worse
    set_size: int = 0  # of the first finding: itself and what it says it cannot tell from it
    errors: dict[str, float] = field(default_factory=dict)  # relative error per parameter
    covered: dict[str, bool] = field(default_factory=dict)  # 90 % interval holds the truth
    confidences: tuple[tuple[float, bool], ...] = ()  # stated, and whether that finding is right
    extra: int = 0  # findings beyond the truth
    sure_wrong: bool = False  # a wrong name is stated as sure
    gap: float | None = None  # share of the gap that the improved model closes, held out
    localised: bool | None = None
    seconds: float = math.nan
    cpu: float = math.nan
    said: str = ""  # for the list of failures
    trouble: str = ""


def acceptable(effect: Effect) -> set[str]:
    """Names that are right for one concealed effect on this recording."""
    alike = set(effect.get("oracle", {}).get("inseparable", {})) - set(
        NEEDLESS.get(effect["effect"], ())
    )
    return {effect["effect"], *effect["accepted"], *alike}


def mechanisms(effect: Effect) -> set[str]:
    """Mechanisms that are right for it."""
    named = {MECHANISM[name] for name in acceptable(effect) if name in MECHANISM}
    return named | set(effect.get("mechanisms", ()))


def placed(finding: Finding, effect: Effect) -> bool:
    """The finding stands where the effect acts: on its body, or on its joint."""
    if effect.get("body") and finding.effect in BODILY:
        return finding.body in ("", effect["body"])
    return finding.joint in effect["accepted_joints"]


def matches(finding: Finding, effect: Effect) -> bool:
    """The finding names the effect's law, or a set that holds it, where it acts."""
    if not placed(finding, effect):
        return False
    return finding.effect in acceptable(effect) or effect["effect"] in finding.indistinguishable


def same_mechanism(finding: Finding, effect: Effect) -> bool:
    """The finding names the effect's mechanism where it acts, by whatever law."""
    stated = mechanism_of(finding.effect, finding.mechanism)
    return placed(finding, effect) and (stated in mechanisms(effect) or matches(finding, effect))


def assigned(findings: Sequence[Finding], effects: Sequence[Effect]) -> dict[int, int]:
    """Truth index -> finding index, each finding used once, exact names first."""
    out: dict[int, int] = {}
    for exact in (True, False):
        for t, effect in enumerate(effects):
            for f, finding in enumerate(findings):
                fits = matches(finding, effect) and (
                    finding.effect == effect["effect"] or not exact
                )
                if t not in out and f not in out.values() and fits:
                    out[t] = f
    return out


def refined(answer: Answer, effects: Sequence[Effect], found: Mapping[int, int]) -> set[int]:
    """Truths that stand among the refinements beside a larger one of their mechanism that was
    found.
    """
    out = set()
    for t, effect in enumerate(effects):
        beside = any(
            effects[other]["joint"] == effect["joint"]
            and mechanism_of(effects[other]["effect"]) == mechanism_of(effect["effect"])
            for other in found
        )
        if t not in found and beside and any(matches(r, effect) for r in answer.refinements):
            out.add(t)
    return out


def rightness(
    findings: Sequence[Finding], effects: Sequence[Effect], also_true: set[str]
) -> list[str]:
    """Of each finding: "law" where its law is right, "mechanism" where only that is, "" beyond the
    truth.

    A second finding of a mechanism that acts once is beyond the truth, unless its law is right too.
    """
    out = [
        "law" if stands_beside(f, also_true) or any(matches(f, e) for e in effects) else ""
        for f in findings
    ]
    taken = {t for t, e in enumerate(effects) if any(matches(f, e) for f in findings)}
    for k, finding in enumerate(findings):
        if out[k]:
            continue
        for t, effect in enumerate(effects):
            if t not in taken and same_mechanism(finding, effect):
                out[k] = "mechanism"
                taken.add(t)
                break
    return out


def stands_beside(finding: Finding, also_true: set[str]) -> bool:
    """The finding names what is true of the machine beside what a case conceals, by its law or by
    its mechanism without one.
    """
    known = {MECHANISM[name] for name in also_true if name in MECHANISM}
    held = finding.effect == "unknown" and finding.mechanism in known
    return finding.effect in also_true or held


def held_back(finding: Finding, effects: Sequence[Effect]) -> bool:
    """A mechanism that acts, claimed without a law."""
    if finding.effect == "disturbance":  # what no state explains: a mechanism that is its own law
        return any("disturbance" in mechanisms(e) and placed(finding, e) for e in effects)
    return finding.effect == "unknown" and any(same_mechanism(finding, e) for e in effects)


def difference(name: str, found: float, true: float) -> float:
    """Found less true, around the circle for angles."""
    d = found - true
    return math.remainder(d, 2 * math.pi) if name in ANGLES else d


def compare_parameters(
    finding: Finding, effect: Effect
) -> tuple[dict[str, float], dict[str, bool]]:
    """Relative errors and 90 % coverage of the parameters that this case scores."""
    errors, covered = {}, {}
    for name, entry in effect["parameters"].items():
        if name in effect["unscored"] or name not in finding.parameters:
            continue
        estimate, true = finding.parameters[name], entry["value"]
        d = difference(name, estimate.value, true)
        key = f"{effect['effect']}.{name}"
        if name not in (*ANGLES, *PLACES) and true != 0.0:
            errors[key] = abs(d / true)
        if math.isfinite(estimate.std) and estimate.std > 0:
            covered[key] = abs(d) <= Z90 * estimate.std
    return errors, covered


def located(answer: Answer, where: Sequence[Place]) -> bool | None:
    """Whether a reported region, among the first three, holds the place where the truth acts."""
    if not where:
        return None
    for place in where:
        if place["variable"] == "time":
            lo, hi = place["interval"]
            inside = sum(max(0.0, min(b, hi) - max(a, lo)) for a, b in answer.times)
            total = sum(b - a for a, b in answer.times)
            if total > 0 and inside >= 0.5 * total:
                return True
            continue
        for region in answer.regions[:3]:
            lo, hi = region.interval
            here = region.joint == place["joint"] and region.variable == place["variable"]
            if here and lo <= place["value"] <= hi:
                return True
    return False


def describe(answer: Answer) -> str:
    """The answer in one short phrase."""
    if answer.trouble:
        return answer.trouble
    words = []
    for f in answer.findings:
        name = f"{mechanism_of(f.effect, f.mechanism)}?" if f.effect == "unknown" else f.effect
        also = f"~{'/'.join(f.indistinguishable)}" if f.indistinguishable else ""
        words.append(f"{name}@{f.body or f.joint}{also}")
    return f"{answer.verdict}: {', '.join(words)}" if words else answer.verdict


def overlooked(effects: Sequence[Effect], answer: Answer) -> bool | None:
    """Called complete, though an effect is larger than the report says that the recording would
    have shown.

    None where the report states no size for any of them.
    """
    known = []
    for effect in effects:
        name = SIZE.get(effect["effect"], "")
        if name not in effect["parameters"]:
            continue
        size = abs(effect["parameters"][name]["value"])
        known += [
            size > s.size
            for s in answer.smallest
            if s.effect == effect["effect"] and s.joint in effect["accepted_joints"]
        ]
    return (answer.verdict == "complete" and any(known)) if known else None


def worsened(answer: Answer) -> bool | None:
    """Whether what was found makes the untouched recording worse; None where nothing was, or it was
    not tried.
    """
    calibrated, improved = answer.untouched
    if not answer.findings or math.isnan(calibrated) or math.isnan(improved):
        return None
    return improved > WORSE * calibrated


def judge(truth: Truth, answer: Answer) -> Judgement:
    """Judge one answer.

    Parameters
    ----------
    truth : Truth
        As sealed by ``zendsp.proof.cases``.
    """
    effects = truth["effects"]
    first = answer.findings[0] if answer.findings else None
    judged = Judgement(
        case=truth["case"],
        machine=truth["machine"],
        kind=truth["kind"],
        effects=tuple(e["effect"] for e in effects),
        size=truth["size"],
        reality=truth.get("reality", "own"),
        seed=truth.get("seed", 0),
        given=truth.get("given", ""),
        first=f"{first.effect} of {first.body or first.joint}" if first else "",
        detectable=all(e.get("oracle", {}).get("detectable", True) for e in effects),
        seconds=answer.seconds,
        cpu=answer.cpu,
        said=describe(answer),
        trouble=answer.trouble,
        set_size=1 + len(first.indistinguishable) if first else 0,
        localised=located(answer, truth.get("where", [])),
        worse=worsened(answer),
    )
    also_true = set(truth.get("also_true", ()))
    if truth["verdict"] == "complete":
        return of_nothing(judged, answer, also_true)
    physics = [e for e in effects if e["effect"] != "foreign"]
    if not physics:
        return of_foreign(judged, answer, effects, also_true)
    return of_physics(judged, truth, answer, physics, also_true)


def of_nothing(judged: Judgement, answer: Answer, also_true: set[str]) -> Judgement:
    """Answers about a machine whose given model is complete: every name is an error."""
    right = [stands_beside(f, also_true) for f in answer.findings]
    unexplained = answer.verdict == "unexplained" and "unexplained" not in also_true
    alarm = not all(right) or (unexplained and not answer.findings)
    return replace(
        counted(judged, answer, ["law" if ok else "" for ok in right]),
        alarm=None if answer.trouble else alarm,
    )


def of_foreign(
    judged: Judgement, answer: Answer, effects: Sequence[Effect], also_true: set[str]
) -> Judgement:
    """Answers about a torque without a law: unexplained, or a mechanism that acts with no law
    claimed.
    """
    right = [stands_beside(f, also_true) or held_back(f, effects) for f in answer.findings]
    said = answer.verdict == "unexplained" or bool(answer.findings)
    plain = max(e.get("oracle", {}).get("torque_share", 1.0) for e in effects) >= FAINTEST
    unseen = answer.verdict == "complete" and not plain
    return replace(
        counted(judged, answer, ["law" if ok else "" for ok in right]),
        refused=None if unseen else said and all(right),
    )


def counted(judged: Judgement, answer: Answer, right: Sequence[str]) -> Judgement:
    """With what is counted over all findings, of the rightness of each."""
    sound = [
        r == "law" or (r == "mechanism" and f.effect == "unknown")
        for f, r in zip(answer.findings, right, strict=True)
    ]
    stated = tuple((f.confidence, ok) for f, ok in zip(answer.findings, sound, strict=True))
    return replace(
        judged,
        confidences=stated,
        extra=sum(not r for r in right),
        sure_wrong=any(c >= SURE and not ok for c, ok in stated),
    )


def of_physics(
    judged: Judgement, truth: Truth, answer: Answer, physics: Sequence[Effect], also_true: set[str]
) -> Judgement:
    """Answers about effects that have names."""
    findings = answer.findings
    links = assigned(findings, physics)
    leading = {t: f for t, f in links.items() if f < len(physics)}
    all_lead = len(leading) == len(physics)
    named = strict = both = replaced = None
    if len(physics) == 1:
        named = leading.get(0) == 0
        strict = named and findings[0].effect == physics[0]["effect"]
    elif truth["kind"] in ("pair", "all"):
        both = len(leading) + len(refined(answer, physics, leading)) == len(physics)
    if truth["kind"] == "replace":
        replaced = all_lead and set(truth["replaces"]) <= {n for f in findings for n in f.replaces}
    errors: dict[str, float] = {}
    covered: dict[str, bool] = {}
    for t, f in links.items():
        if findings[f].effect == physics[t]["effect"]:
            more, inside = compare_parameters(findings[f], physics[t])
            errors |= more
            covered |= inside
    scored = all_lead and all(e["effect"] != "disturbance" for e in physics)
    return replace(
        counted(judged, answer, rightness(findings, physics, also_true)),
        mechanism=bool(findings) and any(same_mechanism(findings[0], e) for e in physics),
        law=bool(findings) and any(matches(findings[0], e) for e in physics),
        missed=overlooked(physics, answer),
        named=named,
        strict=strict,
        both=both,
        replaced=replaced,
        errors=errors,
        covered=covered,
        gap=gap_closed(answer) if scored else None,
    )


def gap_closed(answer: Answer) -> float | None:
    """(calibrated - improved) / (calibrated - noise floor) on the held-out recording."""
    gap = answer.calibrated - answer.noise_floor
    if not math.isfinite(gap) or gap <= 0:
        return None
    return (answer.calibrated - answer.improved) / gap
