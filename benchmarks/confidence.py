"""How often findings are right, and what the diagnosis should say of it.

Diagnoses cases whose truth is known, judges every finding, and fits the logistic regression of
`zendsp.diagnosis.decide.confidence` to them; its reliability is shown on makers left out of it.

    zendsp prove --make cases --seed 21 --sample 120
    python benchmarks/confidence.py cases

Laws that were refused for their confidence count too. The weights in the code are the prior, each
with a standard deviation of a half: what they were learned on need not be kept.

Several folders are taken together, each finding once. About ten seconds of one core a case; what
was diagnosed is kept beside the cases, so an interrupted run goes on.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

from zendsp.diagnosis import diagnose
from zendsp.diagnosis.decide.confidence import NAMES, WEIGHTS, features
from zendsp.diagnosis.report.files import report_text
from zendsp.proof.answer import read_report
from zendsp.proof.judge import held_back, matches, rightness
from zendsp.proof.seal import open_truth

Array = npt.NDArray[np.float64]
PRIOR = 0.5  # standard deviation
BINS = (0.0, 0.3, 0.5, 0.7, 0.8, 0.9, 1.001)


def main() -> None:
    """Diagnose the folders' cases and print weights and reliability."""
    if len(sys.argv) < 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    rows = [row for folder in sys.argv[1:] for row in judged(Path(folder))]
    x = np.array([r["features"] for r in rows])
    y = np.array([r["right"] for r in rows], float)
    maker = np.array([r["reality"] for r in rows])
    print(f"{len(y)} findings, {int(y.sum())} right")
    found = fitted(x, y)
    for name, now, new in zip(NAMES, WEIGHTS, found, strict=True):
        print(f"  {name:10s} {now:6.2f} in the code, {new:6.2f} from these")
    show("as the code states it", probability(x, np.array(WEIGHTS)), y)
    if len(set(maker)) > 1:
        left_out = np.zeros(len(y))
        for one in set(maker):
            left_out[maker == one] = probability(x, fitted(x[maker != one], y[maker != one]))[
                maker == one
            ]
        show("each maker by a regression on the others", left_out, y)


def judged(folder: Path) -> Iterator[dict[str, Any]]:
    """Every finding of the joints in a folder of cases: its features and whether it is right."""
    truths = open_truth(folder / "truth")
    kept = folder / "findings.jsonl"
    done = {}
    if kept.exists():
        done = {r["case"]: r for r in map(json.loads, kept.read_text().splitlines())}
    for name, truth in sorted(truths.items()):
        if name not in done:
            print(f"{folder}/{name}", file=sys.stderr)
            done[name] = {"case": name, "findings": list(of_case(folder / "cases" / name, truth))}
            with kept.open("a") as file:
                file.write(json.dumps(done[name]) + "\n")
        yield from done[name]["findings"]


def of_case(case: Path, truth: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """The same of one case."""
    listing = json.loads((case / "case.json").read_text())
    train, heldout = ([case / n for n in listing[key]] for key in ("train", "heldout"))
    d = diagnose(train, case / listing["model"], heldout or None, jobs=1)
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        report.write_text(report_text(d))
        answer = read_report(report, 0.0)
    effects, also = truth["effects"], set(truth["also_true"])
    named = truth["verdict"] == "missing"
    right = rightness(answer.findings, effects, also) if named else []
    for k, finding in enumerate(answer.findings):
        sound = finding.effect in also or held_back(finding, effects)
        if named:
            sound = right[k] == "law" or (right[k] == "mechanism" and finding.effect == "unknown")
        for decision in getattr(d.workings, "decisions", ()):
            for claim in decision.claims:
                if (decision.joint, claim.effect) == (finding.joint, finding.effect):
                    law = claim
                    if claim.effect == "unknown" and claim.term.effect != "unknown":
                        law = replace(claim, effect=claim.term.effect)
                        doubted = replace(finding, effect=law.effect)
                        sound = named and any(matches(doubted, e) for e in effects)
                    yield {
                        "features": features(law, decision),
                        "right": sound,
                        "reality": truth.get("reality", "own"),
                    }


def fitted(x: Array, y: Array) -> Array:
    """Weights of a logistic regression, drawn to those in the code."""
    known = np.array(WEIGHTS)

    def cost(w: Array) -> float:
        z = x @ w
        return float(np.sum(np.logaddexp(0, z) - y * z) + 0.5 * np.sum(((w - known) / PRIOR) ** 2))

    return np.asarray(minimize(cost, known).x)


def probability(x: Array, w: Array) -> Array:
    return np.asarray(1.0 / (1.0 + np.exp(-x @ w)))


def show(title: str, p: Array, y: Array) -> None:
    """Stated against right, bin by bin."""
    print(f"{title}: Brier score {np.mean((p - y) ** 2):.3f}")
    for low, high in pairwise(BINS):
        here = (p >= low) & (p < high)
        if here.any():
            print(
                f"  {low:.1f} to {min(high, 1):.1f}: {int(here.sum()):4d} findings, stated"
                f" {p[here].mean():.2f}, right {y[here].mean():.2f}"
            )


if __name__ == "__main__":
    main()
