"""The report as one self-contained page that prints well and needs no network."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

from zendsp.diagnosis.data.sampling import whole_second
from zendsp.diagnosis.decide.contract import Verdict, dark
from zendsp.diagnosis.decide.findings import Finding, number
from zendsp.diagnosis.decide.result import Diagnosis, Errors
from zendsp.diagnosis.report.chart import Chart
from zendsp.diagnosis.report.summary import SMALLER, before, hidden, standing, unasked, unnamed
from zendsp.diagnosis.report.times import times_in_words

SAID = 4  # findings on the first sheet
SHARE = (
    "Share: what comes back when the law is taken away and all else is fitted anew, its mean square"
    " as a part of that of all the torque that the calibrated model lacks. It is what nothing else"
    " here can stand in for: where laws can replace one another in these recordings, each has a"
    " small share, however large its torque is."
)
NO_INTERVAL = (
    "No interval of a joint's own velocity, position, acceleration or command holds more of its"
    " mismatch beyond chance."
)
NOWHERE = "Nothing is missing that these recordings show, so no place is named."
UNTOLD = "The untouched recordings do not show what those of the fit say, so no place is named."
FEW_PASSES = " Where a picture shows more, too few passes went there to say so."
CSS = """
body{font:15px/1.5 system-ui,sans-serif;color:#222;max-width:54rem;margin:2rem auto;padding:0 1rem}
h1{font-size:1.5rem;margin:0}h2{font-size:1.1rem;margin:2rem 0 .5rem;border-bottom:1px solid #ccc}
.verdict{padding:.8rem 1rem;border-left:6px solid #888;background:#f4f4f2;margin:1rem 0;font-size:1.05rem}
.missing{border-color:#b4451f}.complete{border-color:#3a7d44}.unexplained{border-color:#8a6d00}
table{border-collapse:collapse;width:100%;margin:.5rem 0}th,td{text-align:left;padding:.25rem .6rem;border-bottom:1px solid #e2e2e2;vertical-align:top}
td.n,th.n{text-align:right;font-variant-numeric:tabular-nums}img{max-width:100%;display:block;margin:.4rem 0}
.small{color:#666;font-size:.85rem}figure{margin:.6rem 0;break-inside:avoid}@media print{body{margin:0;max-width:none}h2{break-after:avoid}.more{break-before:page}}
"""  # noqa: E501

def page(d: Diagnosis, figures: list[tuple[Chart, Path]]) -> str:
    """The HTML of the whole report with its pictures: first a sheet with the essentials, then the
    details.

    Parameters
    ----------
    figures : list of (chart, path of its picture)
    """
    shows = "fit" if d.verdict == Verdict.COMPLETE else "where"  # of the first picture
    order = [f for section in ("law", shows, "fit") for f in figures if f[0].section == section]
    first = next(iter(order), None)
    rest = [f for f in figures if f is not first]
    title = f"Diagnosis of the model “{escape(d.given.name)}”"
    parts = [
        (
            "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport"
            f" content='width=device-width'><title>{title}</title>"
        ),
        f"<style>{CSS}</style><h1>{title}</h1>",
        f"<div class='verdict {_colour(d)}'><b>{escape(d.headline)}</b>{_sentences(d)}</div>",
        _pictures([first] if first else [], first[0].section if first else ""),
        _untouched(d),
        _left(d),
        _could_not(d),
    ]
    if d.next_recording:
        parts.append(f"<p><b>Record next:</b> {escape(d.next_recording.sentence)}</p>")
    parts += ["<div class=more><h2>The fit</h2>", _fit_table(d), _pictures(rest, "fit")]
    if d.findings:
        parts += ["<h2>Findings</h2>", _findings_table(d.findings)]
        parts.append(_pictures(rest, "law", named=True))
    if d.refinements:
        words = "What improves the fit further, and is not claimed as physics of its own."
        words += "".join(
            f" {f.effect} of joint {f.joint} is what {by} stands upon."
            for f, by in standing(d)
        )
        parts += ["<h2>Refinements</h2>", f"<p>{words}</p>", _findings_table(d.refinements)]
    where = _pictures(rest, "where")
    parts += ["<h2>Where the mismatch lives</h2>", _where(d, pictured=bool(where)), where]
    parts += ["<h2>What remains</h2>", _pictures(rest, "white")]
    if d.rejected:
        parts += ["<h2>Rejected rivals</h2>", _rejected(d)]
    if d.notes:
        parts += ["<h2>About the data</h2><ul>", *[f"<li>{escape(n)}" for n in d.notes], "</ul>"]
    parts.append(
        f"<p class=small>{d.seconds:.1f} s. ± is one standard deviation. Calibrated: the given"
        " model with its free parameters fitted again. Untouched: what neither the fit nor any"
        " choice has seen; of a single held-out recording, the second half of its motion. Errors"
        " are drawn of it.</p></div>"
        "</html>"
    )
    return "\n".join(parts)


def _sentences(d: Diagnosis) -> str:
    said = d.findings if len(d.findings) <= SAID else d.findings[: SAID - 1]
    items = [
        f"<li>{escape(f.sentence)} <span class=small>confidence {100 * f.confidence:.0f} %</span>"
        for f in said
    ]
    if len(said) < len(d.findings):
        items.append(f"<li>and {len(d.findings) - len(said)} more, under <i>Findings</i>")
    items += [f"<li>{escape(words)}" for words in d.unexplained.splitlines()]
    return f"<ul>{''.join(items)}</ul>" if items else ""


def _untouched(d: Diagnosis) -> str:
    return "".join(_untouched_of(d, e) for e in d.errors)


def _untouched_of(d: Diagnosis, e: Errors) -> str:
    t, begin = e.test, f"<p><b>Untouched recordings{e.of}:</b> RMS position error"
    floor = f"the sensor alone {e.noise_floor:.2g} {e.unit}.</p>"
    if not d.findings:
        return f"{begin} {t.calibrated:.3g} {e.unit}; {floor}"
    of, error = before(t.given, t.calibrated, t.improved)
    times = error / t.improved if t.improved > 0 else float("inf")
    smaller = f"{times:.0f}" if times >= 10.0 else f"{times:.2g}"
    told = f" ({smaller} times smaller)" if times >= SMALLER else ""
    return (
        f"{begin} {error:.3g} {e.unit} {of}, {t.improved:.3g} {e.unit} with what was found{told};"
        f" {floor}"
    )


def _left(d: Diagnosis) -> str:
    items = [f"joint {x.joint}: {unnamed(x.share, x.interval[1])}" for x in d.discrepancy]
    return f"<p><b>What nothing named explains:</b> {'; '.join(items)}.</p>" if items else ""


def _could_not(d: Diagnosis) -> str:
    """A table for each joint of the smallest sizes that these recordings would have shown, and what
    they would not have shown.
    """
    joints = sorted({x.joint for x in d.detectable})
    rows = []
    for joint in joints:
        sizes = ", ".join(
            f"{escape(x.effect)} {x.size:.2g}{'' if x.unit == '1' else f' {escape(x.unit)}'}"
            for x in d.detectable
            if x.joint == joint
        )
        rows.append(f"<li>joint {joint}: {sizes}")
    if any(x.mechanism == "transmission" and x.at for x in d.detectable):
        rows.append("<li>a spring and a gap are those of a load with half of the inertia")
    if d.undetectable:
        unseen = escape(hidden(d.undetectable, d))
        rows.append(f"<li>may be missed here even if large: {unseen}")
    return (
        "<p><b>What may have been missed:</b> what is smaller than this. Of what is as large, nine"
        " of ten would have been found; of what is half or a third of it, many are, too. Of the"
        f" other laws no size is asked: {', '.join(unasked(d))}.</p>"
        f"<ul>{''.join(rows)}</ul>"
        if rows
        else ""
    )


def _fit_table(d: Diagnosis) -> str:
    return "".join(_fit_of(e) for e in d.errors)


def _fit_of(e: Errors) -> str:
    rows = "".join(
        f"<tr><td>{name}<td class=n>{t.given:.3g}<td class=n>{t.calibrated:.3g}<td"
        f" class=n><b>{t.improved:.3g}</b><td class=n>{e.noise_floor:.3g}"
        for name, t in (
            ("recordings of the fit", e.estimation), ("held-out recordings", e.heldout),
            ("of these, untouched", e.test),
        )
    )  # fmt: skip
    return (
        f"<table><tr><th>RMS position error within {e.window:.3g} s [{e.unit}]{e.of}"
        f"<th class=n>given<th class=n>calibrated<th class=n>improved<th class=n>noise floor{rows}"
        "</table>"
    )


def _colour(d: Diagnosis) -> str:
    """The style of the verdict; a complete model with unseen joints gets that of "cannot tell"."""
    unseen = dark((x.joint, x.interval) for x in d.discrepancy)
    return Verdict.UNEXPLAINED if d.verdict == Verdict.COMPLETE and unseen else d.verdict


def _findings_table(findings: Sequence[Finding]) -> str:
    rows = [
        "<tr><th>mechanism<th>law<th>joint<th>parameters<th class=n>share<th"
        " class=n>confidence<th>cannot be told from<th>replaces"
    ]
    for f in findings:
        numbers = "<br>".join(f"{escape(n)} = {escape(number(e))}" for n, e in f.parameters.items())
        rows.append(
            f"<tr><td>{escape(f.word)}<td>{escape(f.effect)}<td>{f.joint}<td>{numbers}"
            f"<td class=n>{_percent(f.share)}<td class=n>{100 * f.confidence:.0f} %"
            f"<td>{escape(', '.join(f.indistinguishable)) or '—'}<td>{escape(', '.join(f.replaces)) or '—'}"  # noqa: E501
        )
    return f"<table>{''.join(rows)}</table><p class=small>{SHARE}</p>"


def _percent(share: float) -> str:
    return "&lt; 0.5 %" if 0.0 < share < 0.005 else f"{100 * share:.0f} %"


def _where(d: Diagnosis, *, pictured: bool = False) -> str:
    doubt = FEW_PASSES if pictured else ""
    if not d.regions and not d.times:
        if d.verdict == Verdict.COMPLETE:
            return f"<p>{UNTOLD if d.doubted else NOWHERE}</p>"
        return f"<p>{NO_INTERVAL} Nor does any interval of time.{doubt}</p>"
    rows = [
        "<tr><th>joint<th>variable<th>from … to<th class=n>of the mismatch<th class=n>of the time"
    ]
    for r in d.regions:
        rows.append(
            f"<tr><td>{r.joint}<td>{r.variable}<td>{r.interval[0]:.4g} … {r.interval[1]:.4g}"
            f" {escape(r.unit)}<td class=n>{100 * r.share:.0f} %"
            f"<td class=n>{100 * r.time_share:.0f} %"
        )
    first = min((float(m.time[0]) for parts in d.missing.values() for m in parts), default=0.0)
    begin = whole_second(first)
    of = d.times_of if len(set(d.times_of)) > 1 else [""] * len(d.times)
    when = escape(times_in_words(d, of, len(d.times), begin))
    when += f", after {begin:.0f} s" if when and begin else ""
    table = f"<table>{''.join(rows)}</table>" if d.regions else f"<p>{NO_INTERVAL}{doubt}</p>"
    return f"{table}<p>In time: {when or 'spread evenly'}.</p>"


def _rejected(d: Diagnosis) -> str:
    rows = ["<tr><th>effect<th>joint<th>why not<th class=n>log-likelihood against what was chosen"]
    rows += [
        f"<tr><td>{escape(r.effect)}<td>{r.joint}<td>{escape(r.why)}<td class=n>{r.score:z.0f}"
        for r in d.rejected
    ]
    return f"<table>{''.join(rows)}</table>"


def _pictures(
    figures: list[tuple[Chart, Path]], section: str, *, named: bool = False
) -> str:
    """The pictures in HTML; ``named``: each law with its sentence above it."""
    out = []
    for chart, path in figures:
        if chart.section == section:
            data = base64.b64encode(path.read_bytes()).decode()
            note = f"<figcaption class=small>{escape(chart.note)}</figcaption>"
            said = f"<p>{escape(chart.caption)}</p>" if section == "law" else ""
            out.append(
                f"<figure>{said if named else ''}<img alt='{escape(chart.caption, quote=True)}'"
                f" src='data:image/png;base64,{data}'>{note if chart.note else ''}</figure>"
            )
    return "".join(out)
