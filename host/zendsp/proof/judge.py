"""Compares one answer with one sealed truth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from zendsp.proof.answer import Answer, Finding

# nothing to divide an error by: angles, and places that may lie near zero
ANGLES = ("phase", "angle")
PLACES = ("neutral",)
Z90 = 1.645
# kinds of case with a small slow random torque in the background
NUISANCES = ("nuisance", "nuisance_single", "hard", "hard_complete")


@dataclass(frozen=True)
class Judgement:
    """How one answer stands to the truth; None where the question does not apply."""

    case: str
    machine: str
    kind: str
    effects: tuple[str, ...]
    size: float
    detectable: bool
    strict: bool | None = None  # single effect: the very name first, on the right joint
    named: bool | None = None  # first finding is right, or right set
    both: bool | None = None  # pairs: both among the first two
    replaced: bool | None = None  # the wrong law named as replaced, and the right ones found
    alarm: bool | None = None  # complete machines: something was claimed
    refused: bool | None = None  # foreign torque: called unexplained, no physics claimed
    set_size: int = 0  # of the first finding: itself and what it says it cannot tell from it
    errors: dict[str, float] = field(default_factory=dict)  # relative error per parameter
    covered: dict[str, bool] = field(default_factory=dict)  # 90 % interval holds the truth
    confidences: tuple[tuple[float, bool], ...] = ()  # stated, and whether that finding is right
    extra: int = 0  # findings that match nothing in the truth
    gap: float | None = None  # share of the gap that the improved model closes, held out
    localised: bool | None = None
    seconds: float = math.nan
    said: str = ""  # for the list of failures
    trouble: str = ""


def acceptable(effect: Mapping[str, Any]) -> set[str]:
    """Names that are right for one concealed effect on this recording."""
    return {effect["effect"], *effect["accepted"], *effect.get("oracle", {}).get("inseparable", {})}


def matches(finding: Finding, effect: Mapping[str, Any]) -> bool:
    """The finding names the effect, or a set that holds it, on a joint where it acts."""
    if finding.joint not in effect["accepted_joints"]:
        return False
    return finding.effect in acceptable(effect) or effect["effect"] in finding.indistinguishable


def assigned(findings: tuple[Finding, ...], effects: list[Mapping[str, Any]]) -> dict[int, int]:
    """Truth index -> finding index, each finding used once, exact names first."""
    out: dict[int, int] = {}
    for exact in (True, False):
        for t, effect in enumerate(effects):
            for f, finding in enumerate(findings):
                fits = matches(finding, effect) and (finding.effect == effect["effect"] or not exact)
                if t not in out and f not in out.values() and fits:
                    out[t] = f
    return out


def difference(name: str, found: float, true: float) -> float:
    """Found less true, around the circle for angles."""
    d = found - true
    return math.remainder(d, 2 * math.pi) if name in ANGLES else d


def compare_parameters(
    finding: Finding, effect: Mapping[str, Any]
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


def located(answer: Answer, where: list[Mapping[str, Any]]) -> bool | None:
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
            if (
                region.joint == place["joint"]
                and region.variable == place["variable"]
                and lo <= place["value"] <= hi
            ):
                return True
    return False


def describe(answer: Answer) -> str:
    """The answer in one short phrase."""
    if answer.trouble:
        return answer.trouble
    words = [
        f"{f.effect}@{f.joint}" + (f"~{'/'.join(f.indistinguishable)}" if f.indistinguishable else "")
        for f in answer.findings
    ]
    return f"{answer.verdict}: {', '.join(words)}" if words else answer.verdict


def judge(truth: Mapping[str, Any], answer: Answer) -> Judgement:
    """Judge one answer.

    Parameters
    ----------
    truth : mapping
        As sealed by ``zendsp.proof.cases``.
    answer : Answer
    """
    effects: list[Mapping[str, Any]] = list(truth["effects"])
    kind = truth["kind"]
    physics = [e for e in effects if e["effect"] != "foreign"]
    links = assigned(answer.findings, physics)
    first = answer.findings[0] if answer.findings else None
    table: dict[str, Any] = {
        "case": truth["case"],
        "machine": truth["machine"],
        "kind": kind,
        "effects": tuple(e["effect"] for e in effects),
        "size": truth["size"],
        "detectable": all(e.get("oracle", {}).get("detectable", True) for e in effects),
        "seconds": answer.seconds,
        "said": describe(answer),
        "trouble": answer.trouble,
        "set_size": 1 + len(first.indistinguishable) if first else 0,
        "localised": located(answer, truth.get("where", [])),
    }
    # a nuisance is a torque that no state explains: to call it a disturbance is true
    also_true = {"disturbance"} if kind in NUISANCES else set()
    if truth["verdict"] == "complete":
        false = [f for f in answer.findings if f.effect not in also_true]
        silent = answer.verdict == "complete" or bool(answer.findings)
        table["alarm"] = None if answer.trouble else bool(false) or not silent
        table["confidences"] = tuple((f.confidence, f.effect in also_true) for f in answer.findings)
        return Judgement(**table)
    if not physics:
        table["refused"] = answer.verdict == "unexplained" and not answer.findings
        table["confidences"] = tuple((f.confidence, False) for f in answer.findings)
        return Judgement(**table)
    right = [f.effect in also_true or any(matches(f, e) for e in physics) for f in answer.findings]
    table["confidences"] = tuple((f.confidence, ok) for f, ok in zip(answer.findings, right, strict=True))
    table["extra"] = len(right) - sum(right)
    leading = {t: f for t, f in links.items() if f < len(physics)}
    if len(physics) == 1:
        table["named"] = leading.get(0) == 0
        table["strict"] = bool(table["named"]) and answer.findings[0].effect == physics[0]["effect"]
    elif kind == "pair":
        table["both"] = len(leading) == len(physics)
    if kind == "replace":
        gone = {name for f in answer.findings for name in f.replaces}
        table["replaced"] = len(leading) == len(physics) and set(truth["replaces"]) <= gone
    errors: dict[str, float] = {}
    covered: dict[str, bool] = {}
    for t, f in links.items():
        if answer.findings[f].effect == physics[t]["effect"]:
            more, inside = compare_parameters(answer.findings[f], physics[t])
            errors |= more
            covered |= inside
    table["errors"], table["covered"] = errors, covered
    if len(leading) == len(physics) and all(e["effect"] != "disturbance" for e in physics):
        table["gap"] = gap_closed(answer)
    return Judgement(**table)


def gap_closed(answer: Answer) -> float | None:
    """(calibrated - improved) / (calibrated - noise floor) on the held-out recording."""
    gap = answer.calibrated - answer.noise_floor
    if not math.isfinite(gap) or gap <= 0:
        return None
    return (answer.calibrated - answer.improved) / gap
