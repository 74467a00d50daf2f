"""Counts judgements into the scoreboard of the proof."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from scipy.stats import beta

from zendsp.proof.judge import Judgement

SINGLE_KINDS = ("single", "behind", "part", "nuisance_single", "hard")  # one effect concealed
BINS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0000001)
FEWEST = 20  # findings in a tenth, below which its hit rate says nothing


def upper_bound(bad: int, total: int) -> float:
    """One-sided Clopper-Pearson bound of a rate: with 95 % confidence it is not above this."""
    if total == 0:
        return 1.0
    return 1.0 if bad == total else float(beta.ppf(0.95, bad + 1, total - bad))


def rate(values: Iterable[bool | None]) -> tuple[int, int]:
    """(how many are true, of how many that apply)."""
    known = [v for v in values if v is not None]
    return sum(known), len(known)


def _shown(good: int, total: int) -> str:
    return f"{good}/{total} = {good / total:.1%}" if total else "-"


def _percentile(values: Sequence[float], share: float) -> float:
    ordered = sorted(values)
    return (
        ordered[min(len(ordered) - 1, math.ceil(share * len(ordered)) - 1)] if ordered else math.nan
    )


def headline(judged: Sequence[Judgement]) -> list[tuple[str, str, str]]:
    """Rows (what, measured, wanted) of the scoreboard."""
    named = [j for j in judged if j.mechanism is not None and j.detectable]
    singles = [j for j in judged if j.kind in SINGLE_KINDS and j.named is not None and j.detectable]
    complete = [j for j in judged if j.alarm is not None]
    alarms, quiet = rate(j.alarm for j in complete)
    errors = [e for j in judged for e in j.errors.values()]
    gap, worst = calibration_gap(judged), worst_tenth(judged)
    covered = rate(c for j in judged for c in j.covered.values())
    gaps = [j.gap for j in judged if j.gap is not None]
    failed = [j for j in judged if j.trouble]
    answered = [j for j in judged if not j.trouble]
    return [
        (
            "mechanism first, on its joint or body", _shown(*rate(j.mechanism for j in named)),
            ">= 97 %",
        ),
        ("law first (or the set that holds it)", _shown(*rate(j.law for j in named)), ">= 92 %"),
        ("  of one effect alone", _shown(*rate(j.named for j in singles)), ">= 95 %"),
        ("  the very name", _shown(*rate(j.strict for j in singles)), ""),
        ("  mean size of the set", f"{_mean([j.set_size for j in singles if j.named]):.2f}", ""),
        ("all of several effects", _shown(*rate(j.both for j in judged)), ">= 85 %"),
        ("wrong term replaced", _shown(*rate(j.replaced for j in judged)), ">= 85 %"),
        (
            "false alarms", f"{_shown(alarms, quiet)}, 95 % bound {upper_bound(alarms, quiet):.1%}",
            "<= 2 %",
        ),
        ("foreign torque: no law claimed", _shown(*rate(j.refused for j in judged)), ">= 90 %"),
        (
            "names beyond the truth, per case with an effect",
            f"{_mean([j.extra for j in judged if j.effects]):.2f}", "<= 0.1",
        ),
        (
            "names beyond the truth, per case of any kind",
            f"{_mean([j.extra for j in judged]):.2f}", "",
        ),
        (
            "cases with a wrong name stated at 80 % or more",
            _shown(*rate(j.sure_wrong for j in answered)),
            "<= 2 %",
        ),
        (
            "called complete above the size stated as seen",
            _shown(*rate(j.missed for j in judged)),
            "0",
        ),
        ("findings that make untouched data worse", _shown(*rate(j.worse for j in judged)), "0"),
        (
            "parameter error, median",
            f"{statistics.median(errors):.2%}" if errors else "-",
            "<= 3 %",
        ),
        ("90 % intervals hold the truth", _shown(*covered), "85-95 %"),
        (
            "stated confidence less hit rate, mean",
            f"{100 * gap:.1f} points" if math.isfinite(gap) else "-",
            "<= 5 points",
        ),
        (
            "  in the worst tenth of 20 or more",
            f"{100 * worst:.1f} points" if math.isfinite(worst) else "-",
            "<= 5 points",
        ),
        (
            "gap to the noise closed, held out, median",
            f"{statistics.median(gaps):.1%}" if gaps else "-",
            ">= 90 %",
        ),
        ("place found", _shown(*rate(j.localised for j in judged)), ""),
        ("seconds, median / 95 %", spread([j.seconds for j in judged]), ""),
        ("CPU seconds, median / 95 %", spread([j.cpu for j in judged]), ""),
        ("no answer (error, time limit, broken report)", _shown(len(failed), len(judged)), "0"),
    ]


def spread(values: Sequence[float]) -> str:
    """Median and 95 % of what is known."""
    known = [v for v in values if math.isfinite(v)]
    return f"{_percentile(known, 0.5):.1f} / {_percentile(known, 0.95):.1f}" if known else "-"


@dataclass(frozen=True)
class Marks:
    """What some forty cases must show, below which something is broken.

    So few cases cannot tell 97 % from 90 %. They can tell a diagnosis that decides from one that
    accepts whatever its search proposes (docs/prove.md has both, measured).
    """

    mechanism: float = 0.8  # first, of what is detectable
    alarms: float = 0.15  # of complete machines
    refused: float = 0.25  # foreign torques without a law claimed
    extra: float = 0.5  # names beyond the truth, per case
    sure_wrong: float = 0.2  # cases with a wrong name stated at 80 % or more
    worse: float = 0.1  # cases whose findings make untouched data worse


def missed_marks(judged: Sequence[Judgement]) -> list[str]:
    """One line for each mark that a run does not reach; a mark that no case asks for is reached."""
    marks = Marks()
    answered = [j for j in judged if not j.trouble]
    rates = (
        ("mechanism first", [j.mechanism for j in judged if j.detectable], marks.mechanism, True),
        ("false alarms", [j.alarm for j in judged], marks.alarms, False),
        ("foreign torque without a law claimed", [j.refused for j in judged], marks.refused, True),
        (
            "cases with a wrong name stated as sure", [j.sure_wrong for j in answered],
            marks.sure_wrong, False,
        ),
        ("findings that make untouched data worse", [j.worse for j in judged], marks.worse, False),
    )
    out = []
    for what, values, mark, least in rates:
        good, total = rate(values)
        if total and (good < mark * total if least else good > mark * total):
            out.append(
                f"{what}: {_shown(good, total)}, {'at least' if least else 'at most'} {mark:.0%}"
            )
    extra = _mean([j.extra for j in answered])
    if extra > marks.extra:
        out.append(f"names beyond the truth, per case: {extra:.2f}, at most {marks.extra:g}")
    return out


def by_reality(judged: Sequence[Judgement]) -> dict[str, list[Judgement]]:
    """The judgements of each reality, by its name."""
    return {
        name: [j for j in judged if j.reality == name]
        for name in sorted({j.reality for j in judged})
    }


def by_given(judged: Sequence[Judgement]) -> list[tuple[str, str, str, str]]:
    """Rows (form, cases, mechanism first, law first) of cases whose model was given as URDF and as
    MJCF; the last says how often both had the same first name. Empty where none was.
    """
    twins = {(j.reality, j.seed): j for j in judged if j.given == "mjcf"}
    pairs = [
        (j, twins[j.reality, j.seed])
        for j in judged
        if not j.given and (j.reality, j.seed) in twins
    ]
    if not pairs:
        return []
    rows = [
        (
            f"given as {form}",
            str(len(pairs)),
            _shown(*rate(pair[k].mechanism for pair in pairs)),
            _shown(*rate(pair[k].law for pair in pairs)),
        )
        for k, form in enumerate(("urdf", "mjcf"))
    ]
    same = _shown(*rate(a.first == b.first for a, b in pairs))
    return [*rows, ("the same first name in both", str(len(pairs)), same, "")]


def _mean(values: Sequence[float]) -> float:
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
                    _mean([p[0] for p in inside]),
                    _mean([float(p[1]) for p in inside]),
                )
            )
    return out


def calibration_gap(judged: Sequence[Judgement]) -> float:
    """Mean of |stated - hit rate| over the bins, weighted by their counts (expected calibration
    error).
    """
    bins = reliability(judged)
    total = sum(b[2] for b in bins)
    return sum(b[2] * abs(b[3] - b[4]) for b in bins) / total if total else math.nan


def worst_tenth(judged: Sequence[Judgement]) -> float:
    """Largest |stated - hit rate| of a tenth that holds enough findings."""
    return max((abs(b[3] - b[4]) for b in reliability(judged) if b[2] >= FEWEST), default=math.nan)


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
            or j.law is False
            or j.both is False
            or j.replaced is False
            or j.alarm
            or j.refused is False
            or j.missed
            or j.worse
        )
        if wrong:
            truth = "+".join(j.effects) or "nothing"
            faint = "" if j.detectable else " (below detection)"
            right = " (mechanism right)" if j.mechanism and not j.law else ""
            worse = " (untouched data worse)" if j.worse else ""
            out.append(
                f"{j.case} {j.machine} {j.kind} x{j.size:g}{faint}: truth {truth}; said"
                f" {j.said}{right}{worse}"
            )
    return out


def _columns(judged: Sequence[Judgement]) -> Mapping[str, Sequence[Judgement]]:
    groups = by_reality(judged)
    return {"": judged} if len(groups) < 2 else groups


def rates(judged: Sequence[Judgement], title: str) -> str:
    """The rates for a terminal; a column for each reality where there are several."""
    columns = _columns(judged)
    heads = [headline(group) for group in columns.values()]
    width = max(len(row[0]) for row in heads[0])
    lines = [f"{title}: {len(judged)} cases", ""]
    if len(columns) > 1:
        lines.append(f"  {'':<{width}}  " + "".join(f"{name:<34} " for name in columns))
    for k, (what, _, wanted) in enumerate(heads[0]):
        lines.append(
            f"  {what:<{width}}  " + "".join(f"{head[k][1]:<34} " for head in heads) + wanted
        )
    return "\n".join(lines)


def text(judged: Sequence[Judgement], title: str) -> str:
    """The whole scoreboard for a terminal: rates, effects, machines, confidence, failures."""
    lines = [rates(judged, title)]
    sizes = sorted({j.size for j in judged if j.kind in SINGLE_KINDS}, reverse=True)
    lines += ["", "  named first, by effect and size: " + "  ".join(f"x{s:g}" for s in sizes)]
    for name, *cells in table_of(judged, lambda j: j.effects[0], sizes):
        lines.append(f"    {name:<22}" + "".join(f"{c:>8}" for c in cells))
    lines.append("  by machine and kind")
    for name, *cells in table_of(judged, lambda j: f"{j.machine} {j.kind}", sizes):
        lines.append(f"    {name:<22}" + "".join(f"{c:>8}" for c in cells))
    for form, cases, first, law in by_given(judged):
        lines.append(f"  {form:<30}{cases:>5}   {first:<22}{law}".rstrip())
    for name, group in _columns(judged).items():
        lines += ["", f"  stated confidence      findings   mean stated   right   {name}".rstrip()]
        for low, high, count, stated, hit in reliability(group):
            lines.append(f"    {low:.1f} to {high:.1f}   {count:>14} {stated:>13.3f} {hit:>7.3f}")
    wrong = failures(judged)
    lines += ["", f"  failures: {len(wrong)}"] + [f"    {line}" for line in wrong]
    return "\n".join(lines)
