"""The figure of each finding as numbers: the torque over the variable on which it depends, or over
time, without the law and with it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.decide.fast_ripple import RIPPLE_BAND
from zendsp.diagnosis.decide.findings import Finding, torque_word
from zendsp.diagnosis.decide.pieces import beside_unknown
from zendsp.diagnosis.decide.result import Diagnosis, Workings
from zendsp.diagnosis.measure.curve import BINS, Axis, Curve, Samples, binned, curve_over
from zendsp.diagnosis.measure.discrepancy import band_of
from zendsp.diagnosis.measure.where import AROUND, VARIABLES, Missing, mismatch
from zendsp.diagnosis.report.chart import Chart, Panel, Series
from zendsp.diagnosis.report.curve_panels import (
    common_limits,
    curve_panel,
    law_name,
    off_the_means,
    two_panels,
)
from zendsp.diagnosis.report.sides import (
    Sides,
    as_given,
    between,
    clearest,
    torque_label,
    units_at,
)
from zendsp.physics.calibration.fit import Data
from zendsp.physics.effects import get_effect, library, mechanism_of
from zendsp.physics.model import Term
from zendsp.physics.term_numbers import kernel_model

Array = npt.NDArray[np.float64]
FAST_PATTERN = 40  # periods over the travel: a pattern with more is drawn by a faster observer
FOLDED = 6  # periods over the travel: a pattern with more is drawn over one period
# of the observer's bandwidth: a pattern that passes faster is flattened
FLATTENED = 0.5
MAY_STICK = 0.2  # of that speed: below, dry friction may hold the joint
CURVE_SAMPLES = 300  # samples of a curve
IN_A_WAVE = 8  # least bins of a wave: with fewer it looks like another wave, or noise
MOST_BINS = 400
SHOWN = 0.5  # of a law's energy: if its curve explains less, the law is drawn over time
SHOWN_S = 2.0  # span of such a figure
# times the own speed of a law: it is drawn up to there where the whole range hides it
SLOW_SPEEDS = 6.0
UNCHANGED = 1e-9  # relative change of a number that counts as none
LARGEST_BAR = 0.99  # quantile used as the largest


def axis_of(finding: Finding) -> Axis:
    """The axis over which a finding is best seen; for a coupling the other joint's motion, for a
    torque without a law that of its curve.

    Examples
    --------
    >>> said = {"from_joint": 2, "law": "coulomb"}
    >>> str(axis_of(Finding("coupling", 1, {}, 0.9, 1.0, (), (), "", said)))
    'velocity of joints 1 + 2'
    >>> said = {"curve": {"variable": "position"}}
    >>> str(axis_of(Finding("unknown", 1, {}, 0.9, 1.0, (), (), "", said)))
    'position'
    """
    if (curve := finding.numbers.get("curve")) is not None:
        return Axis(curve["variable"])
    effect, other = finding.effect, finding.numbers.get("from_joint")
    if effect == "coupling" and other is not None:
        law = finding.numbers.get("law")
        if law == "coulomb":
            return Axis("velocity", tuple(sorted((finding.joint, other))))
        return Axis("acceleration" if law == "inertia" else "velocity", (other,))
    if effect in library():
        return Axis(library()[effect].over)
    return Axis("time" if effect == "disturbance" else "velocity")


def law_chart(d: Diagnosis, w: Workings, finding: Finding, index: int) -> Chart:
    """What does the found law look like over the data, and what stays with it in the model? For a
    given number that calibration moved: the missing torque with the given one.
    """
    whole = w.whole
    terms = _told_of(d, w, finding)
    replaced = [t for t in whole.calibrated.at(finding.joint) if t.effect in finding.replaces]
    kept = [t for t in whole.improved.terms if t not in terms]
    less, more = f"without {finding.effect}", f"with {finding.effect}"
    two = as_given(kernel_model(d.given), whole.improved)
    if "recordings" in finding.numbers:  # a load of some recordings only
        two = Sides(whole.calibrated, whole.improved, less, more, by_law=True)
    elif terms:
        bare = whole.improved.with_terms((*kept, *replaced))
        two = Sides(bare, whole.improved, less, more, by_law=True)
    if get_effect(finding.effect).site == "body":  # it depends on the motion of all joints
        force = d.given.torque_unit
        alike = [j for j in range(1, d.given.joints + 1) if force(j) == force(finding.joint)]
        return _over_time(d, finding, index, two, *where_most(w.train, two, alike))
    joint, period = finding.joint, _period(finding)
    if _too_fine(w.train, finding):
        band = RIPPLE_BAND
        before, after = (mismatch(w.train, m, joint, RIPPLE_BAND) for m in (two.before, two.after))
    else:
        band, before, after = clearest(w.train, two, joint)
    band = band_of(w.train.records[0][joint - 1], band)
    before, after = (_passing_slowly(m, period, band) for m in (before, after))
    axis, mechanism = axis_of(finding), mechanism_of(finding.effect)
    apart = between(before, after)
    # all three by the same weights, or else the law would not be what lies between the others
    each = [[replace(m, std=a.std) for m, a in zip(s, apart, strict=True)] for s in (before, after)]
    law, *curves = (curve_over(m, axis, mechanism) for m in (apart, *each))
    along, unit = "", units_at(d, joint)["position"]
    if period and float(np.ptp(law.samples.x)) > FOLDED * period:
        law, *curves = (_folded(curve, period) for curve in (law, *curves))
        along = _within(period, unit)
    most = SLOW_SPEEDS * finding.parameters["velocity"].value if _is_slow(finding, axis) else 0.0
    if law.explained < SHOWN and most > 0.0:
        law, *curves = (_up_to(curve, most) for curve in (law, *curves))
    if law.explained < SHOWN and not period:  # a fast pattern is drawn over the position anyway
        return _over_time(d, finding, index, two, joint, before, after)
    chart = two_panels(d, finding, index, [law, *curves], (two.was, two.now))
    panels = tuple(replace(p, xlabel=along or p.xlabel) for p in chart.panels)
    flat = f" What lasts less than {1e3 * AROUND / band:.0f} ms is flatter here than it is."
    torque = units_at(d, joint)["torque"]
    off = off_the_means(curves[1], _size(law), panels[1].xlabel, torque)
    title = _title(finding, joint, two, torque)
    return replace(chart, title=title, panels=panels, note=chart.note + flat + off)


def _size(curve: Curve) -> float:
    """The RMS of a curve's means."""
    return float(np.sqrt(np.mean(curve.mean**2))) if len(curve.mean) else 0.0


def _title(finding: Finding, joint: int, two: Sides, unit: str) -> str:
    """The title of a law's figure: the law's own torque (a model fitted without it would lack
    less); or, for a wrong given number, the missing torque with it.
    """
    if two.by_law:
        what = f"{torque_word(unit)} of {finding.effect}: the improved model without it and with it"
        return f"Joint {joint}: {what}"
    return f"Joint {joint}: {torque_word(unit)} that the {two.lacking} lacks, by {finding.effect}"


def _told_of(d: Diagnosis, w: Workings, finding: Finding) -> list[Term]:
    """The terms that the sentence of a finding includes: its own; refinements, where the sentence
    counts them in; and the Coulomb level under a Stribeck curve, where that is neither given nor a
    finding.
    """
    here, known = w.whole.improved.at(finding.joint), w.whole.calibrated.at(finding.joint)
    own = [t for t in here if t.effect == finding.effect]
    if any(as_stated(d, t) != t for t in own):  # its refinements hold a part of its numbers
        own += [t for t in here if (t.effect, t.joint) in _refining(d, finding)]
    below = {p.above for p in get_effect(finding.effect).parameters}
    below -= {f.effect for f in d.findings if f.joint == finding.joint}
    below -= {t.effect for t in known}
    return own and [*own, *(t for t in here if t.effect in below)]


def as_stated(d: Diagnosis, term: Term) -> Term:
    """A term of the improved model with the numbers of its sentence, which are those without
    refinements: these absorb a part of a law's numbers.
    """
    said = [f for f in d.findings if (f.effect, f.joint) == (term.effect, term.joint)]
    if len(said) != 1 or not _refining(d, said[0]):
        return term
    above = {p.name for p in get_effect(term.effect).parameters if p.above}
    stated = {
        name: replace(q, value=e.value, std=e.std)
        for name, q in term.parameters.items()
        if name not in above
        and (e := said[0].parameters.get(name)) is not None
        and abs(e.value - q.value) > UNCHANGED * abs(q.value)
    }
    return replace(term, parameters={**term.parameters, **stated}) if stated else term


def _refining(d: Diagnosis, finding: Finding) -> set[tuple[str, int]]:
    """Effect and joint of the refinements of a finding's mechanism."""
    key = (finding.mechanism or mechanism_of(finding.effect), finding.joint)
    return {(r.effect, r.joint) for r in d.refinements if (r.mechanism, r.joint) == key}


def _over_time(
    d: Diagnosis,
    finding: Finding,
    index: int,
    two: Sides,
    joint: int,
    before: Sequence[Missing],
    after: Sequence[Missing],
) -> Chart:
    """The chart of a law that is no function of one variable, in the seconds in which it acts most.
    """
    law = between(before, after)
    k, cut = _most(law)
    lines = [
        Series("line", role, m[k].time[cut], drawn(m)[k][cut], label)
        for m, role, label in (
            (before, "before", two.was),
            (law, "law", f"{finding.effect}, as found"),
            (after, "after", two.now),
        )
    ]
    unit = units_at(d, joint)["torque"]
    return Chart(
        "law",
        finding.sentence,
        law_name(finding, index),
        (Panel("time [s]", torque_label(unit), tuple(lines), clock=True),),
        title=f"{_title(finding, joint, two, unit)}, where it acts most",
        size=(7.2, 3.2),
        finding=index,
        joint=joint,
    )


def _most(law: Sequence[Missing]) -> tuple[int, slice]:
    """The recording and its samples in which a torque acts most."""
    size = [max(1, round(SHOWN_S / float(m.time[1] - m.time[0]))) for m in law]
    sums = [
        np.convolve(m.weight * m.torque**2, np.ones(min(n, len(m.time))), "valid")
        for m, n in zip(law, size, strict=True)
    ]
    k = int(np.argmax([float(s.max()) for s in sums]))
    first = int(np.argmax(sums[k]))
    return k, slice(first, first + size[k])


def where_most(
    data: Data, two: Sides, joints: Sequence[int]
) -> tuple[int, list[Missing], list[Missing]]:
    """The joint with the largest torque between two models, and the missing torque of each there.
    """
    best = -1.0
    for joint in joints:
        _, before, after = clearest(data, two, joint)
        law = between(before, after)
        k, cut = _most(law)
        weight = law[k].weight[cut]
        acts = float(np.sum(weight * law[k].torque[cut] ** 2) / max(np.sum(weight), 1e-300))
        if acts > best:
            best, found = acts, (joint, before, after)
    return found


def drawn(lacks: Sequence[Missing]) -> list[Array]:
    """Torques for lines over time, NaN where they are less certain than the largest torque is
    large.
    """
    known = np.concatenate([np.abs(m.torque[np.isfinite(m.std)]) for m in lacks])
    weight = np.concatenate([m.weight[np.isfinite(m.std)] for m in lacks])
    order = np.argsort(known)
    up_to = np.cumsum(weight[order])
    most = known[order][np.searchsorted(up_to, LARGEST_BAR * up_to[-1])] if len(known) else np.inf
    return [np.where(m.std < most, m.torque, np.nan) for m in lacks]


def _period(law: Finding | Term) -> float:
    """The period of a law along the position, rad or m; 0 where it has none."""
    numbers = {name: number.value for name, number in law.parameters.items()}
    if "order" in numbers:
        return 2 * np.pi / max(numbers["order"], 1e-300)
    return numbers.get("period", 0.0)


def _passing_slowly(lacks: list[Missing], period: float, band: float) -> list[Missing]:
    """The samples in which a pattern passes slowly enough to be seen in full, yet too fast for dry
    friction to hold the joint; all samples where these are few.
    """
    fastest = FLATTENED * band * period / (2 * np.pi) or np.inf
    speeds = [np.abs(m.variables["velocity"]) for m in lacks]
    slow = [(v < fastest) & (v > MAY_STICK * fastest) for v in speeds]
    if not period or sum(map(np.count_nonzero, slow)) < CURVE_SAMPLES:
        return lacks
    return [
        replace(m, std=np.where(use, m.std, np.inf)) for m, use in zip(lacks, slow, strict=True)
    ]


def _folded(curve: Curve, period: float) -> Curve:
    """A curve over the position with all periods laid over one another."""
    s = replace(curve.samples, x=np.mod(curve.samples.x, period))
    return Curve(curve.axis, s, *binned(s), curve.against)


def _is_slow(finding: Finding, axis: Axis) -> bool:
    """Whether a law of the speed has a speed of its own, up to which it acts."""
    return axis.variable == "velocity" and "velocity" in finding.parameters


def _up_to(curve: Curve, most: float) -> Curve:
    """A curve over the speed of the samples that are no faster."""
    s, slow = curve.samples, np.abs(curve.samples.x) <= most
    s = Samples(s.x[slow], s.torque[slow], s.weight[slow], s.block[slow])
    return Curve(curve.axis, s, *binned(s), curve.against)


def unknown_chart(d: Diagnosis, w: Workings, finding: Finding, index: int) -> Chart | None:
    """What does a torque without a law look like?"""
    joint, whole = finding.joint, w.whole
    named = {f.effect for f in d.findings if f.joint == joint}
    beside = beside_unknown(whole.calibrated, whole.improved, joint, finding.mechanism, named)
    periods = [_period(t) for t in whole.improved.at(joint) if t not in beside.at(joint)]
    lacks = mismatch(w.train, beside, joint)
    if any(periods):  # waves may pass faster than a slow observer can follow
        band, lacks, _ = clearest(w.train, Sides(beside, whole.improved, "", ""), joint)
        band = band_of(w.train.records[0][joint - 1], band)
        lacks = _passing_slowly(lacks, max(periods), band)
    said = finding.numbers.get("curve")
    if said is None:
        return None
    # over the variable of its sentence, whatever the recordings of the fit suggest
    curve = curve_over(lacks, Axis(said["variable"]), finding.mechanism)
    curve, period = in_waves(curve, [p for p in periods if p])
    chart = _without_a_law(d, joint, curve)
    word = torque_word(units_at(d, joint)["torque"])
    what = f"{word} without a law, which the model lacks beside what is named"
    chart = replace(chart, title=f"Joint {joint}: {what}")
    if period:
        along = _within(period, units_at(d, joint)["position"])
        chart = replace(chart, panels=tuple(replace(p, xlabel=along) for p in chart.panels))
    return replace(chart, caption=finding.sentence, name=law_name(finding, index), finding=index)


def _within(period: float, unit: str) -> str:
    """The label of an axis with all periods laid over one another."""
    return f"position within a period of {period:.4g} {unit} [{unit}]"


def in_waves(curve: Curve, periods: Sequence[float]) -> tuple[Curve, float]:
    """A curve over the position with several bins for each wave, and 0. Where these would be too
    many: the curve with all periods of the longest wave laid over one another, and that period.
    """
    if not periods or curve.axis.variable != "position":
        return curve, 0.0
    s, period = curve.samples, 0.0
    count = math.ceil(IN_A_WAVE * float(np.ptp(s.x)) / min(periods))
    if count > MOST_BINS:
        period = max(periods)
        s = replace(s, x=np.mod(s.x, period))
        count = min(math.ceil(IN_A_WAVE * period / min(periods)), MOST_BINS)
    return Curve(curve.axis, s, *binned(s, max(count, BINS)), curve.against), period


def unclaimed_chart(d: Diagnosis, joint: int) -> Chart | None:
    """What does an unclaimed torque look like? None where it is no curve over one variable of the
    joint's state.
    """
    ways = [(Axis(v), "") for v in VARIABLES] + [(Axis("position"), "dry_friction")]
    curves = [curve_over(d.missing[joint], *way) for way in ways]
    best = max(curves, key=lambda curve: curve.explained)
    if best.explained < SHOWN:
        return None
    word = torque_word(units_at(d, joint)["torque"])
    caption = f"Joint {joint}: the {word} that the calibrated model lacks, over its {best.axis}"
    chart = _without_a_law(d, joint, best)
    return replace(chart, section="where", caption=caption, name=f"lack_joint{joint}")


def _without_a_law(d: Diagnosis, joint: int, curve: Curve) -> Chart:
    panel = curve_panel(d, joint, curve, "before", "without a law")
    unit = units_at(d, joint)["torque"]
    word = torque_word(unit)
    return Chart(
        "law",
        "",
        "",
        (replace(panel, limits=common_limits([panel])),),
        title=f"Joint {joint}: {word} that the calibrated model lacks, over its {curve.axis}",
        size=(7.2, 3.2),
        joint=joint,
        note="Bars are standard errors of the means."
        + off_the_means(curve, _size(curve), panel.xlabel, unit),
    )


def _too_fine(train: Data, finding: Finding) -> bool:
    """Whether a pattern has so many periods over the travel that the observer of the other figures
    cannot follow it.
    """
    order = finding.parameters.get("order")
    travel = max(rec[finding.joint - 1].scale.position for rec in train.records)
    return order is not None and order.value * travel > FAST_PATTERN * 2 * np.pi
