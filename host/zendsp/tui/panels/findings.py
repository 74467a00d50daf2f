"""The lines of a diagnosis to choose from; behind each is a figure or a text."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from zendsp.diagnosis.decide.contract import FindingReport, FitReport, Report, dark
from zendsp.diagnosis.report.chart import Chart
from zendsp.diagnosis.report.summary import before, unnamed
from zendsp.tui.diagnoses import Diagnosed, other_fits
from zendsp_protocol.texts import counted
from zendsp_protocol.views import with_std

LOOP = "loop"  # key of the line about the compensation
LABEL = 7  # columns of a line's label


@dataclass(frozen=True)
class Entry:
    """One line, and what is shown when it is chosen."""

    key: str
    text: Text
    chart: Chart | None = None
    words: str = ""


@dataclass(frozen=True)
class Hanging:
    """A line of the list whose wrapped text continues beside the label, not below it."""

    text: Text

    def __str__(self) -> str:
        return self.text.plain

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        lines = self.text[LABEL:].wrap(console, max(1, options.max_width - LABEL))
        yield Text.assemble(self.text[:LABEL], Text("\n" + " " * LABEL).join(lines))


def headline(report: Report) -> str:
    """The verdict in one sentence; in one word where an older report has no sentence."""
    return report.get("headline", report["verdict"])


def unseen(report: Report) -> tuple[int, ...]:
    """The joints about which the recordings show nothing."""
    return dark((x["joint"], x["interval"]) for x in report["discrepancy"])


def entries(d: Diagnosed, theme: Mapping[str, str]) -> list[Entry]:
    """Every line of a diagnosis, findings first.

    Parameters
    ----------
    theme : mapping of str to str
        Colours by name.
    """
    r, charts = d.report, d.charts
    out = [_finding(k, f, charts, theme) for k, f in enumerate(r["findings"])]
    for k, words in enumerate(r["unexplained"].splitlines()):
        line = Text("left".ljust(LABEL) + words, theme["warning"])
        out.append(Entry(f"unexplained-{k}" if k else "unexplained", line))
    out += _errors(r, charts)
    for c in _of("where", charts):
        out.append(Entry(c.name, _plain("where", c.caption), c, _where(r)))
    out += _left(r, charts)
    out.append(Entry("unseen", _plain("unseen", _unseen_line(r)), None, _unseen(r)))
    if r["next_recording"]:
        sentence = r["next_recording"]["sentence"]
        hint = "\n\nn plays it on the target." if d.next_reference else ""
        out.append(Entry("next", _plain("next", sentence), None, sentence + hint))
    if r["notes"]:
        words = "\n".join(f"· {note}" for note in r["notes"])
        out.append(Entry("notes", _plain("notes", f"{len(r['notes'])} to read"), None, words))
    return out


def _plain(label: str, text: str) -> Text:
    return Text(label.ljust(LABEL), "dim").append(text, "not dim")


def _of(section: str, charts: Sequence[Chart]) -> list[Chart]:
    """The charts of a section that a terminal can draw, joint by joint."""
    drawn = (c for c in charts if c.section == section and all(p.mesh is None for p in c.panels))
    return sorted(drawn, key=lambda c: c.joint)


def _finding(k: int, f: FindingReport, charts: Sequence[Chart], theme: Mapping[str, str]) -> Entry:
    text = Text(f"{100 * f['confidence']:3.0f} %".ljust(LABEL), f"bold {theme['success']}")
    text.append(f["sentence"], "bold")
    words = [f["sentence"], ""]
    words += [
        f"{name:<16} {with_std(p['value'], p['std'], p['unit'])}"
        for name, p in f["parameters"].items()
    ]
    if f["indistinguishable"]:
        words += ["", f"cannot be told from: {', '.join(f['indistinguishable'])}"]
    if f["replaces"]:
        words += ["", f"replaces: {', '.join(f['replaces'])}"]
    own = (c for c in charts if c.finding == k)
    chart = next(own, None) or next((c for c in charts if c.joint == f["joint"]), None)
    words += ["", chart.note] if chart and chart.note else []
    return Entry(f"finding-{k}", text, chart, "\n".join(words))


def _errors(r: Report, charts: Sequence[Chart]) -> list[Entry]:
    fell = "; ".join(_fell(fit, bool(r["findings"])) for fit in (r["fit"], *other_fits(r)))
    fell = f"error on untouched recordings {fell}"
    drawn = _of("fit", charts)
    said = [fell, *(f"joint {c.joint}: its error over time" for c in drawn[1:])]  # of all joints
    made = [Entry(c.name, _plain("fit", text), c) for c, text in zip(drawn, said, strict=False)]
    return made or [Entry("fit", _plain("fit", fell), None, fell)]


def _fell(fit: FitReport, found: bool) -> str:
    """The error before and after what was found, and that of the sensor alone."""
    t, unit = fit["test"], fit["unit"]
    # null: a simulation that ran away
    given, calibrated, improved = (
        math.inf if x is None else x for x in (t["given"], t["calibrated"], t["improved"])
    )
    _, error = before(given, calibrated, improved)
    fell = f"{error:.3g} → {improved:.3g}" if found else f"{calibrated:.3g}"
    return f"{fell} {unit}, the sensor alone {fit['noise_floor']:.2g} {unit}"


def _where(r: Report) -> str:
    return "\n".join(
        f"joint {w['joint']}, {w['variable']} {w['interval'][0]:.3g} … {w['interval'][1]:.3g}"
        f" {w['unit']}:"
        f" {100 * w['share']:.0f} % of the mismatch in {100 * w['time_share']:.0f} % of the time"
        for w in r["where"]["state"]
    )


def _left(r: Report, charts: Sequence[Chart]) -> list[Entry]:
    """The line on the unexplained torque."""
    made = []
    white = {c.joint: c for c in _of("white", charts)}
    refined = [f"{f['sentence']} (improves the fit, not claimed)" for f in r["refinements"]]
    for item in r["discrepancy"]:
        joint, share, between = item["joint"], item["share"], item["interval"]
        if share is None or None in between:
            continue
        line = f"joint {joint}: nothing named explains {unnamed(share, between[1])}"
        words = "\n".join([line, "", *refined])
        made.append(Entry(f"left-{joint}", _plain("left", line), white.get(joint), words))
    return made


def _unseen_line(r: Report) -> str:
    joints = sorted({x["joint"] for x in r["detectable"]})
    if not joints:
        return "what may have been missed is not known for these recordings"
    seen = counted(len(r["detectable"]), "effect")
    return f"what may have been missed: {seen}, each with the size from which on it is surely seen"


def _unseen(r: Report) -> str:
    lines = ["Of these sizes, seen in 90 of 100 times; smaller ones may be missed:", ""]
    lines += [
        f"joint {x['joint']}  {x['effect']:<22} {x['size']:.2g} "
        f"{'' if x['unit'] == '1' else x['unit']}"
        for x in r["detectable"]
    ]
    hidden = [f"joint {x['joint']}  {x['effect']}" for x in r.get("undetectable", ())]
    if hidden:
        lines += ["", "May be missed here even if large:", "", *hidden]
    return "\n".join(lines)
