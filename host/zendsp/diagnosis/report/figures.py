"""The figures of a report as numbers, each answering one question; ``drawing.py`` draws them. Those
of findings are in ``laws.py``.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.sampling import whole_second
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.findings import Finding, torque_word
from zendsp.diagnosis.decide.result import Diagnosis, SimulatorErrors, Workings
from zendsp.diagnosis.measure.curve import Axis, samples_of
from zendsp.diagnosis.measure.where import VARIABLES, energy, lies_in, shares
from zendsp.diagnosis.measure.windows import noise_floor, rows_of, seconds_of, window_error
from zendsp.diagnosis.report.chart import Chart, Mesh, Panel, Series
from zendsp.diagnosis.report.laws import axis_of, drawn, law_chart, unclaimed_chart, unknown_chart
from zendsp.diagnosis.report.sides import Sides, sides, torque_label, units_at
from zendsp.diagnosis.report.torsion import torsion_chart
from zendsp.diagnosis.transmission.findings import measured
from zendsp.physics.calibration.predict import run
from zendsp.physics.effects import library
from zendsp.physics.model import Model
from zendsp.physics.term_numbers import kernel_model

Array = npt.NDArray[np.float64]
MOST_POINTS = 6000  # of a line
MOST_JOINTS = 7  # joints with figures of their own
JOINED = "time [s], one recording after the other"
TIME = "of the time"
SENSOR_ONLY = 1.5  # times the noise floor: a smaller error is hardly more than the sensor's
SENSOR_LEFT = (
    " So near the noise floor they may be the sensor's own: a rounded position errs alike from one"
    " sample to the next."
)
FLOOR_DRAWN = 0.3  # of the noise floor: windows with smaller errors are drawn there


def _thin(count: int) -> slice:
    return slice(None, None, max(1, count // MOST_POINTS))


def _models(two: Sides) -> tuple[tuple[Model, str, str], ...]:
    """Model, role and label of each line; one line where nothing was found."""
    before = (two.before, "before", two.was)
    return (before,) if two.before is two.after else (before, (two.after, "after", two.now))


def error_chart(d: Diagnosis, w: Workings, joint: int) -> Chart:
    """Does the improved model predict untouched data better, and how close is it to the noise?"""
    unit = units_at(d, joint)["position"]
    records = [rec[joint - 1] for rec in w.test.records]
    sizes = [rows_of(r.sample_time) for r in records]
    starts = one_after_the_other(
        [(r.t0, r.n // n * n * r.sample_time) for r, n in zip(records, sizes, strict=True)]
    )
    t = np.concatenate(
        [
            start + np.arange(r.n // n * n) * r.sample_time
            for start, r, n in zip(starts, records, sizes, strict=True)
        ]
    )
    size, over = sizes[0], seconds_of(w.test)
    floor = max(noise_floor(w.test, joint), 1e-300)
    errors, windows = [], []
    for model, role, label in _models(sides(d.findings, kernel_model(d.given), w.whole, joint)):
        error = window_error(w.test, model, joint)[: len(t)]
        cut = _thin(len(error))
        errors.append(Series("line", role, t[: len(error)][cut], error[cut], label))
        blocks = error[: len(error) // size * size].reshape(-1, size)
        each = np.maximum(np.sqrt(np.mean(blocks**2, axis=1)), FLOOR_DRAWN * floor)
        ends = np.r_[t[: len(blocks) * size : size], t[len(blocks) * size - 1]]
        level = np.repeat(each, 2)
        windows.append(Series("line", role, np.repeat(ends, 2)[1:-1], level, label))
    one = len(records) == 1
    axis = "time [s]" if one else JOINED
    since = f" from {starts[0]:.4g} s on" if one else ""
    return Chart(
        "fit",
        f"Joint {joint}: error on the untouched recording",
        f"error_joint{joint}",
        (
            Panel(
                axis,
                f"position error [{unit}]",
                tuple(errors),
                f"Joint {joint}: untouched recording{since}, free simulation over {over:.3g} s",
                clock=one,
            ),
            Panel(
                axis,
                f"RMS [{unit}]",
                tuple(windows),
                log=True,
                level=(floor, "noise floor"),
                clock=one,
            ),
        ),
        ratio=(2, 1),
        size=(7.2, 4.6),
        joint=joint,
    )


def one_after_the_other(parts: list[tuple[float, float]]) -> list[float]:
    """The begin of each recording on a common axis, s: the first by its own clock (of several:
    without the whole seconds of a calendar), the others where the one before ends.
    """
    begin = parts[0][0] - (whole_second(parts[0][0]) if len(parts) > 1 else 0.0)
    return [begin + s for s in np.cumsum([0.0, *(seconds for _, seconds in parts[:-1])]).tolist()]


def torque_chart(d: Diagnosis, two: Sides, joint: int) -> Chart:
    """Which torque did the model lack, and when?"""
    lacks = (d.missing[joint], d.remaining[joint])
    times = [m.time for m in lacks[0]]
    starts = one_after_the_other([(float(t[0]), float(t[-1] - t[0])) for t in times])
    unit = units_at(d, joint)["torque"]
    series = []
    for missing, (_, role, label) in zip(lacks, _models(two), strict=False):
        rows = zip(missing, drawn(missing), starts, strict=True)
        for k, (m, torque, start) in enumerate(rows):
            cut = _thin(len(m.time))
            at = m.time - m.time[0] + start
            series.append(Series("line", role, at[cut], torque[cut], "" if k else label))
    return Chart(
        "where",
        f"Joint {joint}: the {torque_word(unit)} that the {two.lacking} lacks, over time",
        f"torque_joint{joint}",
        (
            Panel(
                "time [s]" if len(times) == 1 else JOINED,
                torque_label(unit),
                tuple(series),
                f"Joint {joint}: {torque_word(unit)} that the {two.lacking} lacks along the"
                f" {_shown_on(d)}",
                spans=_times_of(d, joint) if len(times) == 1 else (),  # of one recording's clock
                clock=len(times) == 1,
            ),
        ),
        size=(7.2, 2.8),
        joint=joint,
    )


def _times_of(d: Diagnosis, joint: int) -> tuple[tuple[float, float], ...]:
    """The told times in which more of this joint's torque lies than elsewhere: of several joints,
    one may have told them alone.
    """
    if len(d.missing) == 1:
        return d.times
    (missing,) = d.missing[joint]
    return tuple(span for span in d.times if lies_in(missing, *span))


def _shown_on(d: Diagnosis) -> str:
    """The recordings that show the missing torque, in words: those of the fit, unless only others
    have it.
    """
    w = d.workings
    held = isinstance(w, Workings) and w.train is w.test
    return "held-out recordings" if held else "recordings of the fit"


def map_chart(d: Diagnosis, joint: int) -> Chart | None:
    """Where does the mismatch live? Over the variable of the first finding, or over the position or
    velocity where only an interval of that is reported. None where the variable is no state.
    """
    over = _told_over(d, joint)
    if over is None or over.variable not in VARIABLES:
        return None
    other = Axis("velocity" if over == Axis("position") else "position")
    lacks = d.missing[joint]
    units = units_at(d, joint)
    x, y, e, counts = (
        np.concatenate(parts)
        for parts in zip(
            *((samples_of(m, over), samples_of(m, other), *energy(m)) for m in lacks),
            strict=True,
        )
    )
    total, xs, ys = np.histogram2d(x, y, bins=28, weights=counts * e)
    seen, _, _ = np.histogram2d(x, y, bins=(xs, ys), weights=counts)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.sqrt(np.maximum(np.where(seen > 0, total / seen, np.nan), 0.0))
    edges = np.unique(np.quantile(x, np.linspace(0, 1, 25)))
    count = len(edges) - 1
    bins = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, count - 1)
    share = shares(e, counts, bins, count)
    time = np.bincount(bins, minlength=count) / len(x)
    centre = 0.5 * (edges[1:] + edges[:-1])
    label, across = (f"{a} [{units[a.variable]}]" for a in (over, other))
    return Chart(
        "where",
        f"Joint {joint}: map of the mismatch",
        f"map_joint{joint}",
        (
            Panel(
                label,
                across,
                title=f"Joint {joint}: where the mismatch lives",
                mesh=Mesh(xs, ys, mean.T, f"missing, RMS [{units['torque']}]"),
            ),
            Panel(
                label,
                "share",
                (
                    Series("bars", "before", centre, share, "of the mismatch", np.diff(edges)),
                    Series("line", "law", np.repeat(edges, 2)[1:-1], np.repeat(time, 2), TIME),
                ),
            ),
        ),
        beside=True,
        ratio=(1.4, 1),
        joint=joint,
    )


def _told_over(d: Diagnosis, joint: int) -> Axis | None:
    """The axis of which the text about a joint speaks; None where there is none."""
    told = [Axis(r.variable) for r in d.regions if r.joint == joint]
    moving = [a for a in told if a.variable in ("position", "velocity")]
    for finding in d.findings:
        if finding.joint == joint:
            over = axis_of(finding)
            return moving[0] if moving and over not in told else over
    return next(iter(told), None)


def finding_chart(d: Diagnosis, w: Workings, finding: Finding, index: int) -> Chart:
    """What does a finding look like in the recordings, and what stays with it in the model?"""
    if finding.effect == "unknown" and (chart := unknown_chart(d, w, finding, index)) is not None:
        return chart
    if measured(finding) and (chart := torsion_chart(d, w, finding, index)) is not None:
        return chart
    if finding.effect in library():
        return law_chart(d, w, finding, index)
    two = sides(d.findings, kernel_model(d.given), w.whole, finding.joint)
    chart = torque_chart(d, two, finding.joint)
    name = f"law_{index + 1}_{finding.effect}_joint{finding.joint}"
    return replace(chart, section="law", caption=finding.sentence, name=name, finding=index)


def white_chart(w: Workings, two: Sides, joint: int, unit: str) -> Chart:
    """Are the improved model's one-step errors white? ``unit``: of the joint's position."""
    record = w.test.records[0][joint - 1]
    bound = float(1.96 / np.sqrt(record.n))
    series, outside, left = [], [], ""
    for model, role, label in _models(two):
        r = run(record, model, 16.0).innovations[record.n // 20 :]
        r = r - r.mean()
        spectrum = np.abs(np.fft.rfft(r, 2 * len(r))) ** 2
        correlation = np.fft.irfft(spectrum)[:201]
        lag = np.arange(1, 201) * record.sample_time
        alike = correlation[1:] / max(correlation[0], 1e-300)
        series.append(Series("line", role, lag, alike, label))
        outside.append(f"{label} {100 * float(np.mean(np.abs(alike) > bound)):.0f} %")
        error = float(np.sqrt(np.mean(window_error(w.test, model, joint) ** 2)))
        floor = noise_floor(w.test, joint)
        left = (
            f" How large it is no curve says: over a window the {label} model errs by {error:.2g}"
            f" {unit}, the sensor alone by {floor:.2g}."
        )
        left += SENSOR_LEFT if error < SENSOR_ONLY * floor else ""
    return Chart(
        "white",
        f"Joint {joint}: whiteness",
        f"whiteness_joint{joint}",
        (
            Panel(
                "lag [s]", "autocorrelation", tuple(series),
                f"Joint {joint}: one-step errors on the untouched recording (band: white noise)",
                band=(-bound, bound),
            ),
        ),
        size=(7.2, 2.4),
        joint=joint,
        note=(
            "Where a curve leaves the band, what is left can be predicted. So many of the lags"
            f" do: {', '.join(outside)}; of white noise 5 %.{left}"
        ),
    )


def simulator_charts(d: Diagnosis, errors: SimulatorErrors) -> list[Chart]:
    """The errors of a simulator on the held-out recording, one chart a joint."""
    before, after = errors.calibrated, errors.improved
    return [
        Chart(
            "fit",
            f"Joint {i + 1}: error on the held-out recording",
            f"error_joint{i + 1}",
            (
                Panel(
                    "time [s]",
                    f"position error [{units_at(d, i + 1)['position']}]",
                    (
                        Series("line", "before", errors.time, before[:, i], "calibrated"),
                        Series("line", "after", errors.time, after[:, i], "improved"),
                    ),
                    f"Joint {i + 1}: held-out recording, measured minus simulated",
                    clock=True,
                ),
            ),
            joint=i + 1,
        )
        for i in range(before.shape[1])
    ]


def from_a_whole_second(panel: Panel) -> Panel:
    """The panel, with calendar times counted from the whole second of their begin."""
    if not (panel.clock and panel.series):
        return panel
    begin = whole_second(float(panel.series[0].x[0]))
    if begin == 0.0:
        return panel
    return replace(
        panel,
        xlabel=f"time [s] after {begin:.0f} s",
        series=tuple(replace(s, x=s.x - begin) for s in panel.series),
        spans=tuple((a - begin, b - begin) for a, b in panel.spans),
    )


def charts(d: Diagnosis) -> list[Chart]:
    """Every figure of a report, in its order."""
    return [replace(c, panels=tuple(map(from_a_whole_second, c.panels))) for c in _charts(d)]


def _charts(d: Diagnosis) -> list[Chart]:
    w = d.workings
    if w is None:
        return []
    if not isinstance(w, Workings):  # of a black-box simulator
        return simulator_charts(d, w)
    here = [(k, f) for k, f in enumerate(d.findings) if not f.is_elsewhere]
    laws = [finding_chart(d, w, f, k) for k, f in here]
    told = {c.joint for c in laws} or {x.joint for x in w.decisions if x.kind != Verdict.COMPLETE}
    joints = (sorted(told | {r.joint for r in d.regions[:1]}) or [1])[:MOST_JOINTS]
    out = [error_chart(d, w, j) for j in joints]
    out += laws
    for j in joints:
        two = sides(d.findings, kernel_model(d.given), w.whole, j)
        curve = None if d.findings else unclaimed_chart(d, j)
        for chart in (curve, torque_chart(d, two, j), map_chart(d, j)):
            out += [chart] if chart else []
        out.append(white_chart(w, two, j, units_at(d, j)["position"]))
    return out
