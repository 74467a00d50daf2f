"""The figures of a report as numbers, each answering one question; ``drawing.py`` draws them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.decide.result import Diagnosis, Finding, SimulatorErrors, Workings
from zendsp.diagnosis.measure.curve import Curve, binned, curve_of, curve_over
from zendsp.diagnosis.measure.discrepancy import BANDS
from zendsp.diagnosis.measure.where import Missing, energy, mismatch
from zendsp.diagnosis.measure.windows import window_error
from zendsp.diagnosis.report.chart import Chart, Mesh, Panel, Series
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.predict import run
from zendsp.physics.effects import library, mechanism_of

Array = npt.NDArray[np.float64]
MOST_JOINTS = 7  # that get figures of their own
FINE = 40  # repetitions over the travel: a pattern with more is a smear, not a curve
FOLDED = 6  # repetitions over the travel: a pattern with more is drawn over one of them
SLOW = 0.5  # of the observer's bandwidth: a pattern that passes faster is flatter in what it says
HELD = 0.2  # of that speed: slower, dry friction may hold the joint
ENOUGH = 1000  # samples of a curve
JOINED = "time [s], one recording after the other"
STAMPS = 1e6  # s: a time beyond is a calendar's stamp


def axis_of(finding: Finding) -> str:
    """The variable over which a finding is best seen: of a coupling, the other joint's motion.

    Examples
    --------
    >>> said = {"from_joint": 2, "law": "coulomb"}
    >>> axis_of(Finding("coupling", 1, {}, 0.9, 1.0, (), (), "", said))
    'velocity of joints 1 + 2'
    """
    effect, other = finding.effect, finding.numbers.get("from_joint")
    if effect == "coupling" and other is not None:
        law = finding.numbers.get("law")
        if law == "coulomb":
            return f"velocity of joints {' + '.join(map(str, sorted((finding.joint, other))))}"
        return f"{'acceleration' if law == 'inertia' else 'velocity'} of joint {other}"
    return (
        library()[effect].over
        if effect in library()
        else "time" if effect == "disturbance" else "velocity"
    )


def _units(d: Diagnosis, joint: int) -> dict[str, str]:
    q = "m" if d.given.joint_kind(joint) == "linear" else "rad"
    force = d.given.torque_unit(joint)
    return {
        "position": q,
        "velocity": f"{q}/s",
        "acceleration": f"{q}/s²",
        "command": d.given.actuator.unit or force,
        "time": "s",
        "torque": force,
    }


def _thin(count: int, most: int = 6000) -> slice:
    return slice(None, None, max(1, count // most))


def error_chart(d: Diagnosis, w: Workings, joint: int) -> Chart:
    """Does the improved model predict the held-out recording better, and how close is it to the
    noise?
    """
    test, whole = w.test, w.whole
    unit = _units(d, joint)["position"]
    period = test.records[0][joint - 1].sample_time
    errors, blocks = [], []
    for model, role, label in (
        (whole.calibrated, "before", "calibrated"),
        (whole.improved, "after", "improved"),
    ):
        error = window_error(test, model, joint)
        t = np.arange(len(error)) * period
        cut = _thin(len(error))
        errors.append(Series("line", role, t[cut], error[cut], label))
        size = 250
        block = error[: len(error) // size * size].reshape(-1, size)
        blocks.append(
            Series(
                "line",
                role,
                (np.arange(len(block)) + 0.5) * size * period,
                np.sqrt(np.mean(block**2, axis=1)) + 1e-300,
                label,
            )
        )
    title = f"Joint {joint}: held-out recording, free simulation over 0.25 s"
    floor = (max(d.noise_floor, 1e-300), "noise floor")
    return Chart(
        "fit",
        f"Joint {joint}: error on the held-out recording",
        f"error_joint{joint}",
        (
            Panel("", f"position error [{unit}]", tuple(errors), title),
            Panel("time [s]", f"RMS [{unit}]", tuple(blocks), log=True, level=floor),
        ),
        ratio=(2, 1),
        size=(7.2, 4.6),
        joint=joint,
    )


def torque_chart(d: Diagnosis, joint: int) -> Chart:
    """Which torque did the calibrated model lack, and when?"""
    before: list[Missing] = d.missing[joint]
    after: list[Missing] = d.remaining[joint]
    unit = _units(d, joint)["torque"]
    # several recordings stand one after the other, from 0 on
    begin, axis = (0.0, "time [s]") if len(before) == 1 else (before[0].time[0], JOINED)
    offset = float(before[0].time[0]) - begin
    series = []
    for k, (a, b) in enumerate(zip(before, after, strict=True)):
        cut = _thin(len(a.time))
        t = a.time - a.time[0] + offset
        for part, role, label in ((a, "before", "calibrated"), (b, "after", "improved")):
            name = "" if k else label
            series.append(Series("line", role, t[cut], part.torque[cut], name))
        offset += float(t[-1] - t[0])
    return Chart(
        "where",
        f"Joint {joint}: the torque that the calibrated model lacks",
        f"torque_joint{joint}",
        (
            Panel(
                axis,
                _torque_label(unit),
                tuple(series),
                f"Joint {joint}: what the model lacks along the recordings of the fit",
                spans=d.times[:4] if len(before) == 1 else (),  # of one recording's clock
            ),
        ),
        size=(7.2, 2.8),
        joint=joint,
    )


def map_chart(d: Diagnosis, joint: int) -> Chart:
    """Where in position and velocity does the mismatch live?"""
    units = _units(d, joint)
    q = np.concatenate([m.variables["position"] for m in d.missing[joint]])
    v = np.concatenate([m.variables["velocity"] for m in d.missing[joint]])
    e = np.concatenate([energy(m) for m in d.missing[joint]])
    total, xs, ys = np.histogram2d(q, v, bins=28, weights=e)
    count, _, _ = np.histogram2d(q, v, bins=(xs, ys))
    with np.errstate(invalid="ignore"):
        mean = np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))
    edges = np.unique(np.quantile(v, np.linspace(0, 1, 25)))
    bins = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, len(edges) - 2)
    share = np.bincount(bins, e, len(edges) - 1) / max(e.sum(), 1e-300)
    time = np.bincount(bins, minlength=len(edges) - 1) / len(v)
    centre = 0.5 * (edges[1:] + edges[:-1])
    speed = f"velocity [{units['velocity']}]"
    return Chart(
        "where",
        f"Joint {joint}: map of the mismatch",
        f"map_joint{joint}",
        (
            Panel(
                f"position [{units['position']}]",
                speed,
                title=f"Joint {joint}: where the mismatch lives",
                mesh=Mesh(xs, ys, mean.T, f"missing, RMS [{units['torque']}]"),
            ),
            Panel(
                speed,
                "share",
                (
                    Series("bars", "before", centre, share, "of the mismatch", np.diff(edges)),
                    Series("step", "law", centre, time, "of the time"),
                ),
            ),
        ),
        beside=True,
        ratio=(1.4, 1),
        joint=joint,
    )


def law_chart(d: Diagnosis, w: Workings, finding: Finding, index: int) -> Chart:
    """What does the law that was found look like over the data, and what stays when it is there?"""
    whole, joint = w.whole, finding.joint
    terms = [t for t in whole.improved.at(joint) if t.effect == finding.effect]
    replaced = [t for t in whole.calibrated.at(joint) if t.effect in finding.replaces]
    without = whole.improved.with_terms(
        (*[t for t in whole.improved.terms if t not in terms], *replaced)
    )
    period = _period(finding)
    before, after = (
        curve_over(
            _passing_slowly(mismatch(w.train, model, joint), period),
            axis_of(finding),
            mechanism_of(finding.effect),
        )
        for model in (without, whole.improved)
    )
    along = ""
    if period and float(np.ptp(before.x)) > FOLDED * period:
        before, after = (_folded(curve, period) for curve in (before, after))
        along = f"position within a period of {period:.4g} {_units(d, joint)['position']}"
    centre, law, _ = binned(before.x, before.torque - after.torque, 120)
    curve = Series("line", "law", centre, law, f"{finding.effect}, as found")
    panels = (
        _curve_panel(d, joint, before, "before", f"without {finding.effect}", curve),
        _curve_panel(d, joint, after, "after", f"with {finding.effect}"),
    )
    limits = panels[0].limits
    left, right = (replace(p, xlabel=along or p.xlabel, limits=limits) for p in panels)
    return Chart(
        "law",
        finding.sentence,
        f"law_{index + 1}_{finding.effect}_joint{joint}",
        (left, right),
        title=f"Joint {joint}: torque that the model lacks",
        beside=True,
        same=True,
        size=(7.2, 3.2),
        finding=index,
        joint=joint,
    )


def _period(finding: Finding) -> float:
    """Of what a law repeats along the position, rad or m; 0 where it does not."""
    if "order" in finding.parameters:
        return 2 * np.pi / max(finding.parameters["order"].value, 1e-300)
    return finding.parameters["period"].value if "period" in finding.parameters else 0.0


def _passing_slowly(lacks: list[Missing], period: float) -> list[Missing]:
    """The samples in which a pattern passes so slowly that what is lacking shows it in full, and
    not in dry friction's stead; all, where these are few.
    """
    fastest = SLOW * BANDS[0] * period / (2 * np.pi) or np.inf
    speeds = [np.abs(m.variables["velocity"]) for m in lacks]
    slow = [(v < fastest) & (v > HELD * fastest) for v in speeds]
    if not period or sum(map(np.count_nonzero, slow)) < ENOUGH:
        return lacks
    return [
        replace(
            m,
            time=m.time[use],
            torque=m.torque[use],
            std=m.std[use],
            variables={name: values[use] for name, values in m.variables.items()},
            others=None if m.others is None else m.others[:, :, use],
        )
        for m, use in zip(lacks, slow, strict=True)
    ]


def _folded(curve: Curve, period: float) -> Curve:
    """A curve over the position, all its periods laid over one another."""
    x = np.mod(curve.x, period)
    return Curve(curve.variable, x, curve.torque, *binned(x, curve.torque), curve.against)


def unknown_chart(d: Diagnosis, w: Workings, finding: Finding, index: int) -> Chart | None:
    """What does the torque look like that no law describes?"""
    joint = finding.joint
    curve = curve_of(mismatch(w.train, w.whole.calibrated, joint), finding.mechanism)
    if curve is None:
        return None
    return Chart(
        "law",
        finding.sentence,
        f"law_{index + 1}_unknown_joint{joint}",
        (_curve_panel(d, joint, curve, "before", "without a law"),),
        title=f"Joint {joint}: torque that the model lacks",
        size=(7.2, 3.2),
        finding=index,
        joint=joint,
    )


def _curve_panel(
    d: Diagnosis, joint: int, curve: Curve, role: str, title: str, *lines: Series
) -> Panel:
    """Samples and means of a curve; the limits leave out what a few samples do."""
    units = _units(d, joint)
    label = _torque_label(units["torque"])
    cut = _thin(len(curve.x), 5000)
    low, high = np.quantile(curve.torque, [0.005, 0.995])
    series = (
        Series("dots", "data", curve.x[cut], curve.torque[cut]),
        Series("means", role, curve.at, curve.mean, f"{title}: means", curve.spread),
        *lines,
    )
    return Panel(
        f"{curve.variable} [{units[curve.variable.split()[0]]}]",
        label.replace(" [", " against the motion [") if curve.against else label,
        series,
        title,
        limits=(float(low - 0.15 * (high - low)), float(high + 0.15 * (high - low))),
    )


def _torque_label(unit: str) -> str:
    return f"{'force' if unit == 'N' else 'torque'} [{unit}]"


def _too_fine(train: Data, finding: Finding) -> bool:
    """Whether a pattern repeats too often over the travel to be drawn, and faster than the torque
    in the figure is seen.
    """
    order = finding.parameters.get("order")
    travel = max(rec[finding.joint - 1].scale.position for rec in train.records)
    return order is not None and order.value * travel > FINE * 2 * np.pi


def white_chart(w: Workings, joint: int) -> Chart:
    """Is anything predictable left in what the improved model does not predict?"""
    whole, test = w.whole, w.test
    record = test.records[0][joint - 1]
    series = []
    for model, role, label in (
        (whole.calibrated, "before", "calibrated"),
        (whole.improved, "after", "improved"),
    ):
        r = run(record, model, 16.0).innovations[record.n // 20 :]
        r = r - r.mean()
        spectrum = np.abs(np.fft.rfft(r, 2 * len(r))) ** 2
        correlation = np.fft.irfft(spectrum)[:201]
        lag = np.arange(1, 201) * record.sample_time
        series.append(
            Series("line", role, lag, correlation[1:] / max(correlation[0], 1e-300), label)
        )
    bound = float(1.96 / np.sqrt(record.n))
    return Chart(
        "white",
        f"Joint {joint}: whiteness",
        f"whiteness_joint{joint}",
        (
            Panel(
                "lag [s]", "autocorrelation", tuple(series),
                f"Joint {joint}: one-step errors on the held-out recording (band: white noise)",
                band=(-bound, bound),
            ),
        ),
        size=(7.2, 2.4),
        joint=joint,
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
                    f"position error [{_units(d, i + 1)['position']}]",
                    (
                        Series("line", "before", errors.time, before[:, i], "calibrated"),
                        Series("line", "after", errors.time, after[:, i], "improved"),
                    ),
                    f"Joint {i + 1}: held-out recording, measured minus simulated",
                ),
            ),
            joint=i + 1,
        )
        for i in range(before.shape[1])
    ]


def whole_second(time: float) -> float:
    """Of a calendar's time stamp the whole second, which a label is read better without; else 0."""
    return float(np.floor(time)) if time > STAMPS else 0.0


def from_a_whole_second(panel: Panel) -> Panel:
    """The same panel, where its axis is a calendar's time from the whole second of its begin."""
    if not (panel.xlabel == "time [s]" and panel.series):
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
    if not isinstance(w, Workings):  # of a simulator that can only be called
        return simulator_charts(d, w)
    joints = sorted({f.joint for f in d.findings} | {r.joint for r in d.regions[:1]}) or [1]
    joints = joints[:MOST_JOINTS]
    out = [error_chart(d, w, j) for j in joints]
    for k, f in enumerate(d.findings):
        known = any(t.effect == f.effect for t in w.whole.improved.at(f.joint))
        if known and not _too_fine(w.train, f):
            out.append(law_chart(d, w, f, k))
        elif f.effect == "unknown" and (chart := unknown_chart(d, w, f, k)) is not None:
            out.append(chart)
    for j in joints:
        out += [torque_chart(d, j), map_chart(d, j), white_chart(w, j)]
    return out
