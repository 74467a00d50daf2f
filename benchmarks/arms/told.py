"""Whether a report names what is concealed from the model."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

BODIES = ("payload", "body", "base_tilt")  # inside an FMU they have no name


def is_true(finding: Mapping[str, Any], truth: Sequence[str]) -> bool:
    """Whether a finding, its mechanism, or what it cannot be told from, is what acts; beside a
    torque of no law, one without a law.
    """
    if "foreign" in truth:
        return str(finding["effect"]) == "unknown"
    joint = finding["joint"]
    names = {f"{finding['effect']}@{joint}", f"{finding.get('mechanism')}@{joint}"}
    for rival in finding["indistinguishable"]:
        effect, _, body = rival.partition(" of link")
        names.add(f"{effect}@{body or joint}")
    return any(names & set(one.split("|")) for one in truth)


def is_right(report: Mapping[str, Any], truth: Sequence[str], also: Sequence[str] = ()) -> bool:
    """Whether all that acts is named, each by a finding of its own, and nothing else; mechanisms in
    ``also`` act too, and need not be named. Of a torque of no law it is enough that something is
    missing, of a body inside an FMU that it says so.
    """
    findings = report["findings"]
    others = [f for f in findings if f["mechanism"] not in also]
    if any(not is_true(f, truth) for f in others):
        return False
    if not truth:
        return report["verdict"] == "complete" or bool(also)
    if "foreign" in truth:
        return report["verdict"] != "complete"
    inside = "a wrong body inside" in str(report["unexplained"])
    missed = [one for one in truth if not any(is_true(f, [one]) for f in findings)]
    hidden = [one for one in missed if inside and one.startswith(BODIES)]
    return missed == hidden and len(others) <= len(truth) - len(missed)


def numbers_off(
    report: Mapping[str, Any], truth: Sequence[str], numbers: Mapping[str, float]
) -> tuple[float, float, float, float] | None:
    """How far a payload that is named is off: its mass in per cent and in stated deviations, its
    centre in mm and, of its worst coordinate, in deviations. None where it is not named.
    """
    for finding in report["findings"]:
        stated = finding["parameters"]
        if numbers and finding["effect"] in BODIES and is_true(finding, truth) and "mass" in stated:
            off = {k: stated[k]["value"] - v for k, v in numbers.items() if k in stated}
            by = {k: abs(v) / stated[k]["std"] for k, v in off.items()}
            mass = off.pop("mass")
            centre = 1e3 * sum(v**2 for v in off.values()) ** 0.5
            mm = max((by[k] for k in off), default=0.0)
            return 100.0 * mass / numbers["mass"], by["mass"], centre, mm
    return None


def kind(name: str) -> str:
    """The class of an arm: its name without joints."""
    return re.match("[a-z]+", name)[0]  # type: ignore[index]
