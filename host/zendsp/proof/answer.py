"""What a diagnosis answered, read from ``report.json`` strictly by the contract of
docs/diagnosis.md.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

VERDICTS = ("complete", "missing", "unexplained")


class ContractError(ValueError):
    """A report is not what the contract says; the message names the key."""


@dataclass(frozen=True)
class Estimate:
    """A parameter as the report states it, SI; ``std`` is NaN where there is none."""

    value: float
    std: float


@dataclass(frozen=True)
class Finding:
    """One effect that a method names."""

    effect: str
    joint: int
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    confidence: float = math.nan
    indistinguishable: tuple[str, ...] = ()
    replaces: tuple[str, ...] = ()
    detail: str = ""  # of a coupling: its law and the joint that it comes from
    mechanism: str = ""
    body: str = ""  # the link, of a payload or a wrong body


@dataclass(frozen=True)
class Region:
    """Where the mismatch concentrates."""

    joint: int
    variable: str
    interval: tuple[float, float]


@dataclass(frozen=True)
class Smallest:
    """The smallest size of an effect that the recording would have shown, as the report states it.
    """

    joint: int
    effect: str
    size: float


@dataclass(frozen=True)
class Answer:
    """The answer of a method to one case; `trouble` says why there is none."""

    verdict: str  # complete | missing | unexplained | "" where it failed
    findings: tuple[Finding, ...] = ()
    regions: tuple[Region, ...] = ()
    times: tuple[tuple[float, float], ...] = ()
    calibrated: float = math.nan  # held-out error, quantity of the report
    improved: float = math.nan
    noise_floor: float = math.nan
    seconds: float = math.nan  # wall clock of the whole command
    trouble: str = ""
    refinements: tuple[Finding, ...] = ()
    smallest: tuple[Smallest, ...] = ()
    cpu: float = math.nan  # CPU seconds of the command and its children
    # error of the calibrated and of the improved model
    untouched: tuple[float, float] = (math.nan, math.nan)

    def to_json(self) -> dict[str, Any]:
        """Plain tables for a results file."""
        return asdict(self)

    @staticmethod
    def from_json(table: Mapping[str, Any]) -> Answer:
        """Read a report; ``ContractError`` where it is not what the contract says."""
        regions = tuple(
            Region(r["joint"], r["variable"], tuple(r["interval"])) for r in table["regions"]
        )
        made = {
            "findings": tuple(kept_finding(f) for f in table["findings"]),
            "refinements": tuple(kept_finding(f) for f in table["refinements"]),
            "smallest": tuple(Smallest(**s) for s in table["smallest"]),
            "regions": regions,
            "times": tuple(map(tuple, table["times"])),
            "untouched": tuple(table["untouched"]),
        }
        return Answer(**{**table, **made})


def kept_finding(table: Mapping[str, Any]) -> Finding:
    """A finding as a results file keeps it."""
    return Finding(
        **{
            **table,
            "parameters": {k: Estimate(**v) for k, v in table["parameters"].items()},
            "indistinguishable": tuple(table["indistinguishable"]),
            "replaces": tuple(table["replaces"]),
        }
    )


def _need(table: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in table:
        raise ContractError(f"report.json: {where} has no {key!r}")
    return table[key]


def number(value: Any, where: str) -> float:
    """A number, or the root mean square of one number per joint."""
    if isinstance(value, bool) or value is None:
        raise ContractError(f"report.json: {where} is {value!r}, expected a number")
    if isinstance(value, int | float):
        return float(value)
    if isinstance(value, Sequence) and not isinstance(value, str) and value:
        return math.sqrt(sum(number(v, where) ** 2 for v in value) / len(value))
    raise ContractError(f"report.json: {where} is {value!r}, expected a number")


def _read_finding(table: Mapping[str, Any], where: str) -> Finding:
    parameters = {}
    for name, entry in _need(table, "parameters", where).items():
        if not isinstance(entry, Mapping) or isinstance(entry.get("value"), str):
            continue  # words, such as the law of a coupling
        spot = f"{where}.parameters.{name}"
        std = entry.get("std")
        parameters[name] = Estimate(
            number(_need(entry, "value", spot), spot),
            math.nan if std is None else number(std, spot),
        )
    confidence = number(_need(table, "confidence", where), f"{where}.confidence")
    if not 0.0 <= confidence <= 1.0:
        raise ContractError(f"report.json: {where}.confidence is {confidence}, expected 0 to 1")
    return Finding(
        str(_need(table, "effect", where)),
        int(_need(table, "joint", where)),
        parameters,
        confidence,
        tuple(names(_need(table, "indistinguishable", where))),
        tuple(names(_need(table, "replaces", where))),
        (
            f"{table['law']}, from joint {table['from_joint']}"
            if {"law", "from_joint"} <= set(table)
            else ""
        ),
        str(table.get("mechanism", "")),
        str(table.get("body", "")),
    )


def read_findings(report: Mapping[str, Any], key: str) -> tuple[Finding, ...]:
    """Every finding below one key of the report."""
    return tuple(
        _read_finding(f, f"{key}[{i}]") for i, f in enumerate(_need(report, key, "the report"))
    )


def names(entries: Sequence[Any]) -> list[str]:
    """Effect names, given as words or as tables with a key ``effect``."""
    return [str(e["effect"]) if isinstance(e, Mapping) else str(e) for e in entries]


def read_report(path: Path, seconds: float) -> Answer:
    """Read a report; `seconds` is the wall clock of the command that wrote it.

    Raises
    ------
    ContractError
        A key is missing or of the wrong kind, or verdict and findings contradict each other.
    """
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError) as error:
        raise ContractError(f"{path}: no readable report.json: {error}") from error
    verdict = _need(table, "verdict", "the report")
    if verdict not in VERDICTS:
        raise ContractError(
            f"report.json: verdict is {verdict!r}, expected one of {', '.join(VERDICTS)}"
        )
    findings = read_findings(table, "findings")
    if verdict == "complete" and findings:
        raise ContractError("report.json: verdict is complete but there are findings")
    if verdict == "missing" and not findings:
        raise ContractError("report.json: verdict is missing but there is no finding")
    where = _need(table, "where", "the report")
    regions = tuple(
        Region(
            int(r["joint"]), str(r["variable"]), (float(r["interval"][0]), float(r["interval"][1]))
        )
        for r in _need(where, "state", "where")
    )
    times = tuple((float(a), float(b)) for a, b in _need(where, "time", "where"))
    fit = _need(table, "fit", "the report")
    held = _need(fit, "heldout", "fit")
    return Answer(
        verdict,
        findings,
        regions,
        times,
        number(_need(held, "calibrated", "fit.heldout"), "fit.heldout.calibrated"),
        number(_need(held, "improved", "fit.heldout"), "fit.heldout.improved"),
        number(_need(fit, "noise_floor", "fit"), "fit.noise_floor"),
        seconds,
        refinements=read_findings(table, "refinements") if "refinements" in table else (),
        smallest=tuple(
            Smallest(int(s["joint"]), str(s["effect"]), number(s["size"], "detectable.size"))
            for s in table.get("detectable", ())
        ),
    )
