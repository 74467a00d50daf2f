"""Counts judgements into the scoreboard of the proof."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Callable, Iterable, Sequence

from scipy.stats import beta

from zendsp.proof.judge import Judgement

SINGLE_KINDS = ("single", "behind", "part", "nuisance_single", "hard")
BINS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0000001)


def upper_bound(bad: int, total: int, level: float = 0.95) -> float:
    """One-sided Clopper-Pearson bound of a rate: with confidence `level` it is not above this."""
    if total == 0:
        return 1.0
    return 1.0 if bad == total else float(beta.ppf(level, bad + 1, total - bad))


def rate(values: Iterable[bool | None]) -> tuple[int, int]:
    """(how many are true, of how many that apply)."""
    known = [v for v in values if v is not None]
    return sum(known), len(known)


def shown(good: int, total: int) -> str:
    return f"{good}/{total} = {good / total:.1%}" if total else "-"


def percentile(values: Sequence[float], share: float) -> float:
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, math.ceil(share * len(ordered)) - 1)] if ordered else math.nan


def headline(judged: Sequence[Judgement]) -> list[tuple[str, str, str]]:
    """Rows (what, measured, wanted) of the scoreboard."""
    singles = [j for j in judged if j.kind in SINGLE_KINDS and j.named is not None and j.detectable]
    complete = [j for j in judged if j.alarm is not None]
    alarms, quiet = rate(j.alarm for j in complete)
    errors = [e for j in judged for e in j.errors.values()]
    gap = calibration_gap(judged)
    covered = rate(c for j in judged for c in j.covered.values())
    gaps = [j.gap for j in judged if j.gap is not None]
    seconds = [j.seconds for j in judged if math.isfinite(j.seconds)]
    failed = [j for j in judged if j.trouble]
    return [
        ("named first (or the set that holds it)", shown(*rate(j.named for j in singles)), ">= 95 %"),
        ("  the very name", shown(*rate(j.strict for j in singles)), ""),
        ("  mean size of the set", f"{mean([j.set_size for j in singles if j.named]):.2f}", ""),
        ("both of two", shown(*rate(j.both for j in judged)), ">= 85 %"),
        ("wrong term replaced", shown(*rate(j.replaced for j in judged)), ">= 85 %"),
        ("false alarms", f"{shown(alarms, quiet)}, 95 % bound {upper_bound(alarms, quiet):.1%}", "<= 2 %"),
        ("foreign effects refused", shown(*rate(j.refused for j in judged)), ">= 90 %"),
        (
            "findings too many, per case with an effect",
            f"{mean([j.extra for j in judged if j.alarm is None]):.2f}",
            "",
        ),
        ("parameter error, median", f"{statistics.median(errors):.2%}" if errors else "-", "<= 3 %"),
        ("90 % intervals hold the truth", shown(*covered), "85-95 %"),
        ("stated confidence less hit rate", f"{100 * gap:.1f} points" if math.isfinite(gap) else "-", "<= 5 points"),
        (
            "gap to the noise closed, held out, median",
            f"{statistics.median(gaps):.1%}" if gaps else "-",
            ">= 90 %",
        ),
        ("place found", shown(*rate(j.localised for j in judged)), ""),
        ("seconds, median / 95 %", f"{percentile(seconds, 0.5):.1f} / {percentile(seconds, 0.95):.1f}", ""),
        ("no answer (error, time limit, broken report)", shown(len(failed), len(judged)), "0"),
    ]


def mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def reliability(judged: Sequence[Judgement]) -> list[tuple[float, float, int, float, float]]:
    """Bins of stated confidence: (from, to, count, mean stated, hit rate)."""
    pairs = [p for j in judged for p in j.confidences if math.isfinite(p[0])]
    out = []
    for low, high in itertools.pairwise(BINS):
        inside = [p for p in pairs if low <= p[0] < high]
        if inside:
            out.append(
                (
                    low,
                    min(high, 1.0),
                    len(inside),
                    mean([p[0] for p in inside]),
                    mean([float(p[1]) for p in inside]),
                )
            )
    return out


def calibration_gap(judged: Sequence[Judgement]) -> float:
    """Mean of |stated - hit rate| over the bins, weighted by their counts (expected calibration error)."""
    bins = reliability(judged)
    total = sum(b[2] for b in bins)
    return sum(b[2] * abs(b[3] - b[4]) for b in bins) / total if total else math.nan


def table_of(
    judged: Sequence[Judgement], key: Callable[[Judgement], str], sizes: Sequence[float]
) -> list[list[str]]:
    """Rows of `key`, columns of sizes: named / asked."""
    singles = [j for j in judged if j.kind in SINGLE_KINDS and j.named is not None]
    rows = []
    for name in sorted({key(j) for j in singles}):
        row = [name]
        for size in sizes:
            good, total = rate(j.named for j in singles if key(j) == name and j.size == size)
            row.append(f"{good}/{total}" if total else "")
        rows.append(row)
    return rows


def failures(judged: Sequence[Judgement]) -> list[str]:
    """One line for each case that went wrong."""
    out = []
    for j in judged:
        wrong = (
            j.trouble
            or j.named is False
            or j.both is False
            or j.replaced is False
            or j.alarm
            or j.refused is False
        )
        if wrong:
            truth = "+".join(j.effects) or "nothing"
            faint = "" if j.detectable else " (below detection)"
            out.append(f"{j.case} {j.machine} {j.kind} x{j.size:g}{faint}: truth {truth}; said {j.said}")
    return out


def text(judged: Sequence[Judgement], title: str) -> str:
    """The whole scoreboard for a terminal."""
    rows = headline(judged)
    width = max(len(r[0]) for r in rows)
    lines = [f"{title}: {len(judged)} cases", ""]
    lines += [f"  {what:<{width}}  {value:<34} {wanted}" for what, value, wanted in rows]
    sizes = sorted({j.size for j in judged if j.kind in SINGLE_KINDS}, reverse=True)
    lines += ["", "  named first, by effect and size: " + "  ".join(f"x{s:g}" for s in sizes)]
    for name, *cells in table_of(judged, lambda j: j.effects[0], sizes):
        lines.append(f"    {name:<22}" + "".join(f"{c:>8}" for c in cells))
    lines.append("  by machine and kind")
    for name, *cells in table_of(judged, lambda j: f"{j.machine} {j.kind}", sizes):
        lines.append(f"    {name:<22}" + "".join(f"{c:>8}" for c in cells))
    lines += ["", "  stated confidence      findings   mean stated   right"]
    for low, high, count, stated, hit in reliability(judged):
        lines.append(f"    {low:.2f} to {high:.2f} {count:>14} {stated:>13.3f} {hit:>7.3f}")
    wrong = failures(judged)
    lines += ["", f"  failures: {len(wrong)}"] + [f"    {line}" for line in wrong]
    return "\n".join(lines)
