"""What a diagnosis returns; ``Diagnosis.report()`` is report.json of the contract."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zendsp.diagnosis.where import Missing, Region
from zendsp.physics.model import Model


@dataclass(frozen=True)
class Estimate:
    """A parameter: value, standard deviation, unit (SI)."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Finding:
    """One missing effect: where, how large, how sure, and what the recording cannot tell from it."""

    effect: str
    joint: int
    parameters: dict[str, Estimate]
    confidence: float
    share: float
    indistinguishable: tuple[str, ...]
    replaces: tuple[str, ...]
    sentence: str
    numbers: dict[str, int | str] = field(default_factory=dict)  # from_joint, law of a coupling


@dataclass(frozen=True)
class Rejected:
    """A hypothesis that was fitted and lost: ``score`` is its log-likelihood against the winner's (negative: worse)."""

    effect: str
    joint: int
    why: str
    score: float


@dataclass(frozen=True)
class FitTable:
    """RMS position error of short free simulations: given, calibrated and improved model."""

    given: float
    calibrated: float
    improved: float

    def as_dict(self) -> dict[str, float]:
        """For the report."""
        return {"given": self.given, "calibrated": self.calibrated, "improved": self.improved}


@dataclass(frozen=True)
class Next:
    """The next recording: what to do and why, and the reference (rad or m over s) that separates what is open."""

    sentence: str
    reference: Any = None  # (time, position, per joint) or None
    separates: tuple[str, ...] = ()


@dataclass
class Diagnosis:
    """The outcome. ``verdict``: "complete", "missing" or "unexplained"."""

    verdict: str
    findings: tuple[Finding, ...]
    regions: tuple[Region, ...]
    times: tuple[tuple[float, float], ...]
    unit: str
    estimation: FitTable
    heldout: FitTable
    noise_floor: float
    rejected: tuple[Rejected, ...]
    next_recording: Next | None
    seconds: float
    notes: tuple[str, ...]
    given: Model
    calibrated: Model
    improved: Model
    unexplained: str = ""
    missing: dict[int, list[Missing]] = field(default_factory=dict)  # torque that the calibrated model lacks
    remaining: dict[int, list[Missing]] = field(default_factory=dict)  # and what the improved one lacks
    details: dict[str, Any] = field(default_factory=dict)
    out: Path | None = None

    def report(self) -> dict[str, Any]:
        """report.json of the contract, as plain numbers and strings."""
        found = []
        for f in self.findings:
            row: dict[str, Any] = {
                "effect": f.effect,
                "joint": f.joint,
                "parameters": {
                    n: {"value": e.value, "std": e.std, "unit": e.unit} for n, e in f.parameters.items()
                },
                "confidence": round(f.confidence, 4),
                "share": round(f.share, 4),
                "indistinguishable": list(f.indistinguishable),
                "replaces": list(f.replaces),
                "sentence": f.sentence,
            }
            row.update(f.numbers)
            found.append(row)
        report: dict[str, Any] = {
            "verdict": self.verdict,
            "findings": found,
            "where": {
                "time": [[round(a, 4), round(b, 4)] for a, b in self.times],
                "state": [
                    {
                        "joint": r.joint,
                        "variable": r.variable,
                        "interval": [r.interval[0], r.interval[1]],
                        "share": round(r.share, 4),
                        "time_share": round(r.time_share, 4),
                    }
                    for r in self.regions
                ],
            },
            "fit": {
                "quantity": "position",
                "unit": self.unit,
                "estimation": self.estimation.as_dict(),
                "heldout": self.heldout.as_dict(),
                "noise_floor": self.noise_floor,
            },
            "rejected": [
                {"effect": r.effect, "joint": r.joint, "why": r.why, "score": round(r.score, 1)}
                for r in self.rejected
            ],
            "next_recording": None
            if self.next_recording is None
            else {
                "sentence": self.next_recording.sentence,
                "reference": "next_reference.mat" if self.next_recording.reference is not None else None,
            },
            "unexplained": self.unexplained,
            "notes": list(self.notes),
            "seconds": round(self.seconds, 3),
        }
        return report

    def __str__(self) -> str:
        lines = [f"verdict: {self.verdict}"]
        lines += [f"  {f.sentence} (confidence {100 * f.confidence:.0f} %)" for f in self.findings]
        if self.unexplained:
            lines.append(f"  {self.unexplained}")
        h = self.heldout
        lines.append(
            f"  held out: given {h.given:.3g}, calibrated {h.calibrated:.3g}, improved {h.improved:.3g} {self.unit} (noise floor {self.noise_floor:.3g})"
        )
        return "\n".join(lines)
