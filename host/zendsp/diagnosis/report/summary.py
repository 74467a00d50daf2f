"""The outcome for a terminal, readable in ten seconds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.headline import SMALLEST_SHARE, percent
from zendsp.diagnosis.report.times import times_in_words
from zendsp.physics.effects import get_effect, library, stands_on, unit_of
from zendsp_protocol.texts import counted

if TYPE_CHECKING:
    from zendsp.diagnosis.decide.findings import Finding
    from zendsp.diagnosis.decide.result import Detectable, Diagnosis

REFINEMENTS = 6  # that a summary names
WHEN = 4  # times of the largest mismatch that a summary names
MISSED = 3  # undetectable effects that a summary names
SMALLER = 1.05  # times: a smaller improvement of the error is not mentioned


def summary(d: Diagnosis) -> str:
    """At most a screen of text: verdict, findings, fit, what could not be seen, and what to do
    next.
    """
    lines = [d.headline, ""]
    for k, f in enumerate(d.findings, 1):
        lines.append(f"{k}. {f.effect}, joint {f.joint} (confidence {100 * f.confidence:.0f} %)")
        lines.append(f"   {f.sentence}")
    lines += d.unexplained.splitlines()
    if d.findings or d.unexplained:
        lines.append("")
    for e in d.errors:
        head = f"RMS position error over {e.window:.3g} s [{e.unit}]"
        wide = max(37, len(f"  recordings of the fit{e.of}") + 2)
        lines.append(f"{head:<{wide}}given    calibrated improved noise floor")
        for name, table in (
            (f"  recordings of the fit{e.of}", e.estimation),
            (f"  untouched recordings{e.of}", e.test),
        ):
            lines.append(
                f"{name:<{wide}}{table.given:<9.3g}{table.calibrated:<11.3g}{table.improved:<9.3g}"
                f"{e.noise_floor:.3g}"
            )
    for r in d.regions[:2]:
        lines.append(
            f"mismatch: joint {r.joint}, {r}: {100 * r.share:.0f} % of it in"
            f" {100 * r.time_share:.0f} % of the time"
        )
    if d.times and d.unexplained:
        lines.append(f"mismatch: largest at {times_in_words(d, d.times_of, WHEN)}")
    if d.refinements:
        more = len(d.refinements) - REFINEMENTS
        lines.append(
            "refinements: "
            + ", ".join(_refinement(f, d) for f in d.refinements[:REFINEMENTS])
            + (f", and {more} more" if more > 0 else "")
        )
    for x in d.discrepancy[:7]:
        if d.verdict != Verdict.COMPLETE or x.interval[1] < 1.0:
            left = unnamed(x.share, x.interval[1])
            lines.append(f"nothing named explains: joint {x.joint}, {left}")
    if d.detectable:
        lines.append(f"what may have been missed: {_missed(d.detectable)}")
    if d.undetectable:
        lines.append(f"may be missed here even if large: {hidden(d.undetectable, d)}")
    if d.next_recording:
        lines += ["", f"next: {d.next_recording.sentence}"]
    if d.notes:
        lines += ["", *[f"note: {n}" for n in d.notes]]
    said = "; ± is one standard deviation" if any("±" in line for line in lines) else ""
    lines.append(f"({d.seconds:.1f} s{said})")
    return "\n".join(lines)


def standing(d: Diagnosis) -> list[tuple[Finding, str]]:
    """The refinements without which a finding would not be, each with the name of that: the dry
    friction beneath a Stribeck curve.
    """
    named = [(f, library()[f.effect]) for f in d.findings if f.effect in library()]
    return [
        (f, found.effect)
        for f in d.refinements
        for found, law in named
        if found.joint == f.joint and stands_on(law, f.effect)
    ]


def _refinement(f: Finding, d: Diagnosis) -> str:
    by = next((f", beneath {by}" for other, by in standing(d) if other is f), "")
    return f"{f.effect} (joint {f.joint}{by})"


def _missed(detectable: Sequence[Detectable]) -> str:
    """The largest effects that the recordings could hide, as parts of the torque, and the largest
    body of each kind; and the count of others.
    """
    bodies = {x.effect: x for x in sorted(detectable, key=lambda x: x.size) if _is_body(x)}
    others = sorted((x for x in detectable if not _is_body(x)), key=lambda x: -x.share)
    largest = [*others[:MISSED], *bodies.values()]
    named = ", ".join(f"{x.effect} below {_sized(x)} (joint {x.joint})" for x in largest)
    more = len(detectable) - len(largest)
    return named + (f", and {counted(more, 'smaller one')}" if more else "")


def hidden(undetectable: Sequence[Detectable], d: Diagnosis) -> str:
    """The effects that these recordings would not show, each with its joints; where that depends on
    the shape of a law, with the one that shows least.
    """
    found = {(f.effect, f.joint) for f in d.findings}
    joints: dict[str, list[str]] = {}
    for x in undetectable:
        name = f"another {x.effect}" if (x.effect, x.joint) in found else x.effect
        at = _shape_of(x, d.given.joint_kind(x.joint))
        joints.setdefault(name, []).append(f"{x.joint} at {at}" if at else str(x.joint))
    return ", ".join(f"{effect} ({_joints(each)})" for effect, each in joints.items())


def _joints(each: Sequence[str]) -> str:
    """The joints of an effect in words.

    Examples
    --------
    >>> _joints(["1", "2"]), _joints(["1 at order 6", "2 at order 3"])
    ('joints 1, 2', 'joint 1 at order 6, joint 2 at order 3')
    """
    if len(each) > 1 and not any(" " in one for one in each):
        return f"joints {', '.join(each)}"
    return ", ".join(f"joint {one}" for one in each)


def unasked(d: Diagnosis) -> list[str]:
    """The laws that are looked for, and of which no smallest size is computed."""
    sought = (e for e in library().values() if e.site != "body" and (e.linear or e.grid or e.scan))
    asked = {x.effect for x in (*d.detectable, *d.undetectable)}
    return [e.name for e in sought if not e.sized and e.name not in asked]


def _shape_of(x: Detectable, kind: str) -> str:
    """The shape at which a law shows least, in words; empty where it has none."""
    words = []
    for name, value in x.at.items():
        unit = unit_of(get_effect(x.effect).parameter(name).size, kind)
        words.append(f"{name.replace('_', ' ')} {value:.2g} {unit}".removesuffix(" 1").rstrip())
    return " and ".join(words)


def _is_body(x: Detectable) -> bool:
    return x.effect in library() and get_effect(x.effect).site == "body"


def _sized(x: Detectable) -> str:
    return f"{x.size:.2g} {x.unit}".removesuffix(" 1")  # a pure number has no unit


def unnamed(share: float, high: float) -> str:
    """The unexplained part of a joint's torque, with its upper limit where that is informative."""
    if share < SMALLEST_SHARE < high:
        return f"at most {percent(high)} of its torque, and perhaps nothing"
    most = f" (at most {percent(high)})" if SMALLEST_SHARE < high < 1.0 else ""
    return f"{percent(share)} of its torque{most}"


def before(given: float, calibrated: float, improved: float) -> tuple[str, float]:
    """The model to compare the improved one with, and its error: the calibrated one; the given one
    where only given numbers were wrong.

    Examples
    --------
    >>> before(4e-3, 3e-3, 1e-3), before(4e-3, 1e-3, 1e-3)
    (('of the calibrated model', 0.003), ('of the model as given', 0.004))
    """
    if calibrated < SMALLER * improved and given > SMALLER * calibrated:
        return "of the model as given", given
    return "of the calibrated model", calibrated
