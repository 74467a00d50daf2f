"""A figure shows what its sentence says, over the same variable, also with coarse encoders."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import KNOWN, RATE

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.reading import read_signals
from zendsp.diagnosis.decide.result import Workings
from zendsp.diagnosis.measure.curve import Axis, Curve, Samples, binned
from zendsp.diagnosis.measure.discrepancy import difference, discrepancy, mean_square
from zendsp.diagnosis.measure.where import Missing, Region, mismatch
from zendsp.diagnosis.report import figures, laws
from zendsp.diagnosis.report.chart import Chart, Panel, Series
from zendsp.diagnosis.report.curve_panels import beside_the_law, broken, off_the_means
from zendsp.diagnosis.report.drawing import SPANS, draw, places
from zendsp.diagnosis.report.figures import charts
from zendsp.diagnosis.report.laws import in_waves, unclaimed_chart
from zendsp.diagnosis.report.sides import torque_label
from zendsp.diagnosis.report.times import joints_at, times_in_words
from zendsp.physics.files.model_file import load_model, parse_model

MODEL = """
sample_time = 0.002
mechanism = { kind = "rotary", parameters = { inertia = { value = 0.01 } } }
columns = { time = "t", position = "q", command = "u" }
"""
Decided = Callable[..., Diagnosis]
COARSE = 2 * np.pi / 500  # rad a count: at 0.8 rad/s it changes once an observer's memory
FINE = 2 * np.pi / 2**20  # rad: an absolute encoder of 20 bits
LEVEL = 0.03  # N m of Coulomb friction


@pytest.fixture(scope="module")
def coarse(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """Coulomb friction is missing, behind an encoder of 500 counts."""
    folder = tmp_path_factory.mktemp("coarse")
    machine = reality.Machine(coulomb=LEVEL, resolution=COARSE)
    files = []
    for seconds, seed in ((12.0, 1), (12.0, 2)):
        reference = reality.multisine(seconds, RATE, seed, high=1.0)
        rows = reality.simulate(machine, reference, RATE, seed)
        files.append(reality.save(folder / f"run{seed}.csv", rows))
    model = reality.model_file(folder / "model.toml", RATE, KNOWN[0], resolution=COARSE)
    return diagnose(files[0], model, files[1], jobs=1)


def _series(chart: Chart, panel: int, kind: str) -> Series:
    return next(s for s in chart.panels[panel].series if s.kind == kind)


def _of(d: Diagnosis, section: str, finding: int = -1) -> Chart:
    return next(c for c in charts(d) if c.section == section and c.finding == finding)


def test_means_of_a_figure_are_the_true_torque_within_their_standard_errors(
    coarse: Diagnosis,
) -> None:
    """An observer with a memory of 30 ms smears a reversal over 0.5 rad/s; outside that the torque
    is the level. One of 30 means is 3 standard errors off in every tenth figure.
    """
    assert [f.effect for f in coarse.findings] == ["coulomb"]
    chart = _of(coarse, "law", 0)
    means = _series(chart, 0, "means")
    away = np.abs(means.x) > 0.5
    assert means.spread is not None and np.count_nonzero(away) > 15
    off = (means.y - LEVEL * np.sign(means.x))[away] / means.spread[away]
    assert np.mean(np.abs(off) < 3.0) > 0.9
    assert np.median(means.spread[away]) < 0.1 * LEVEL, "errors that say something"


def test_no_spike_of_a_coarse_encoder_is_drawn_beside_the_law(coarse: Diagnosis) -> None:
    """At each change of the count the observer corrects at once all that had summed up since the
    last.
    """
    law, where = _of(coarse, "law", 0), _of(coarse, "where")
    assert np.quantile(np.abs(_series(law, 0, "dots").y), 0.99) < 3.0 * LEVEL
    for line in where.panels[0].series:
        assert np.nanmax(np.abs(line.y)) < 3.0 * LEVEL, line.label


def test_panels_before_and_after_have_the_same_axes(coarse: Diagnosis) -> None:
    for section, finding in (("fit", -1), ("law", 0)):
        chart = _of(coarse, section, finding)
        one, other = draw(chart).axes
        assert one.get_xlim() == other.get_xlim()
        if section == "fit":  # as the terminal draws it, each panel by its own data
            spans = [[(s.x[0], s.x[-1]) for s in p.series] for p in chart.panels]
            assert spans[0] == spans[1]
        else:
            assert one.get_ylim() == other.get_ylim()


def test_the_map_of_a_mismatch_shows_no_more_than_the_law(coarse: Diagnosis) -> None:
    """It shows no extra torque at slow motion, where the count seldom changes."""
    (chart,) = (c for c in charts(coarse) if c.name.startswith("map"))
    mesh = chart.panels[0].mesh
    assert mesh is not None and chart.panels[0].xlabel == "velocity [rad/s]"
    assert np.nanmax(mesh.values) < 2.0 * LEVEL


@pytest.mark.parametrize("variable", ["position", "velocity"])
def test_the_map_is_drawn_over_the_variable_of_the_reported_interval(
    coarse: Diagnosis, variable: str
) -> None:
    told = Region(1, variable, (-1.0, 1.0), share=0.66, time_share=0.32, unit="rad")
    chart = figures.map_chart(replace(coarse, regions=(told,)), 1)
    assert chart is not None
    assert all(panel.xlabel.startswith(f"{variable} [") for panel in chart.panels)


def test_the_time_beside_a_map_is_drawn_as_far_as_the_mismatch(coarse: Diagnosis) -> None:
    (chart,) = (c for c in charts(coarse) if c.name.startswith("map"))
    bars, time = chart.panels[1].series
    assert bars.spread is not None
    assert time.x[0] == pytest.approx(bars.x[0] - bars.spread[0] / 2)
    assert time.x[-1] == pytest.approx(bars.x[-1] + bars.spread[-1] / 2)
    assert np.mean(time.y) == pytest.approx(1.0 / len(bars.x), rel=0.5)


def test_the_label_of_a_bar_of_colours_keeps_away_from_the_next_axis(coarse: Diagnosis) -> None:
    (chart,) = (c for c in charts(coarse) if c.name.startswith("map"))
    figure = draw(chart)
    figure.draw_without_rendering()
    _, share, colours = figure.axes
    gap = share.yaxis.label.get_window_extent().x0 - colours.yaxis.label.get_window_extent().x1
    assert gap > colours.yaxis.label.get_window_extent().width, "as wide as a line at the least"


def test_shaded_spans_are_told_in_the_legend() -> None:
    span = Panel("time [s]", "torque [N m]", (), spans=((1.0, 2.0), (3.0, 4.0)))
    (legend,) = draw(Chart("where", "", "torque", (span,))).legends
    assert [text.get_text() for text in legend.get_texts()] == [SPANS]


def test_every_time_that_the_page_tells_is_shaded(coarse: Diagnosis) -> None:
    told = tuple((float(k), k + 0.5) for k in range(1, 6))
    shown = charts(replace(coarse, times=told, times_of=("run1.csv",) * 5))
    (chart,) = (c for c in shown if c.name == "torque_joint1")
    assert chart.panels[0].spans == told


def test_a_time_is_shaded_only_at_the_joints_that_lack_more_then(coarse: Diagnosis) -> None:
    """Joint 2 of an arm was shaded where joint 1 turned fastest and itself lacked less than usual.
    """
    (mine,) = coarse.missing[1]
    early = mine.time < mine.time[0] + 2.0
    lacks = replace(mine, torque=np.where(early, 1.0, 0.1))
    other = replace(mine, torque=np.where(early, 0.1, 1.0))
    span = (float(mine.time[0]), float(mine.time[0]) + 1.5)
    d = replace(coarse, missing={1: [lacks], 2: [other]}, times=(span,), times_of=("run1.csv",))
    assert figures._times_of(d, 1) == (span,) and figures._times_of(d, 2) == ()


def test_times_are_told_with_the_joints_at_which_torque_is_missing_then(coarse: Diagnosis) -> None:
    """Of an arm the page said "In time: 5.96–6.34 s", and of which joint, nobody knew."""
    (mine,) = coarse.missing[1]
    begin = float(mine.time[0])

    def lacking(first: float) -> list[Missing]:
        """For a fifth of a second."""
        then = (begin + first < mine.time) & (mine.time < begin + first + 0.2)
        return [replace(mine, torque=np.where(then, 1.0, 0.01))]

    spans = tuple((begin + k, begin + k + 0.2) for k in (1.0, 3.0, 2.0))
    missing = {1: lacking(1.0), 2: lacking(3.0), 3: lacking(3.0)}
    name = mine.recording
    d = replace(coarse, missing=missing, times=spans, times_of=(name,) * 3, workings=None)
    assert times_in_words(d, ("",) * 3, 3, begin) == (
        "joint 1: 1.00–1.20 s; joints 2 and 3: 3.00–3.20 s; 2.00–2.20 s"
    )
    assert times_in_words(d, (name,) * 3, 1, begin) == f"joint 1: 1.00–1.20 s of {name}; 2 more"
    one = replace(d, missing={1: missing[1]})
    assert times_in_words(one, ("",) * 3, 1, begin) == "1.00–1.20 s and 2 more"
    push = SimpleNamespace(intervals=spans[2:], recordings=(name,))
    pushed: Any = SimpleNamespace(joint=2, beside=None, bursts=push)
    assert isinstance(coarse.workings, Workings)
    d = replace(d, workings=replace(coarse.workings, decisions=[pushed]))
    assert joints_at(d, 2) == (2,) and joints_at(d, 0) == (1,)


def test_a_coarse_encoder_does_not_inflate_the_missing_torque(coarse: Diagnosis) -> None:
    """Three times the torque had been reported: squares of corrections after a plateau of the
    count. Of 0.03 N m a reversal hides a part.
    """
    w = coarse.workings
    assert isinstance(w, Workings)
    calibrated, (record,) = w.whole.calibrated, w.train.records[0]
    speed = record.motion.states[1]
    (viscous,) = (t for t in calibrated.at(1) if t.effect == "viscous")
    lacks = LEVEL * np.sign(speed) + (0.004 - viscous.value("coefficient")) * speed
    truth = np.sqrt(np.mean(lacks**2) / mean_square(w.train, 1))
    assert discrepancy(w.train, calibrated, 1).value == pytest.approx(truth, rel=0.35)
    found = difference(w.train, calibrated, w.whole.improved, 1)
    assert found == pytest.approx(truth, rel=0.35)


def test_the_missing_torque_is_unknown_where_dry_friction_holds_the_model(tmp_path: Path) -> None:
    """With three times the friction the model sticks where the joint moves, and to first order 55 N
    m would be needed to free it. The reported torque is at most the true 0.22 N m.
    """
    machine = reality.Machine(coulomb=0.1, creep=1e-5, ripple=0.02)
    rows = reality.simulate(machine, reality.multisine(9.0, RATE, 1, high=1.0), RATE)
    path = reality.save(tmp_path / "run.csv", rows)
    friction = reality.effect("coulomb", level=0.3)
    model = load_model(reality.model_file(tmp_path / "model.toml", RATE, KNOWN[0], friction))
    data = prepare([read_signals(path, model)], model, 64.0)
    (lacks,) = mismatch(data, model, 1)
    known = np.abs(lacks.torque) > 2.0 * lacks.std
    assert np.mean(known) > 0.5
    assert np.max(np.abs(lacks.torque[known])) < 1.5 * (0.3 - 0.1 + 0.02)


@pytest.mark.parametrize(("low", "high"), [
    (0.00039, 0.0016), (3e-8, 4e-4), (0.2, 0.9), (1.0, 1e9), (0.95, 1.15), (1e-7, 1.0),
])  # fmt: skip
def test_the_numbers_of_a_logarithmic_axis_have_room(low: float, high: float) -> None:
    found = places(low, high)
    assert 3 <= len(found) <= 8 and low <= found[0] and found[-1] <= high
    assert np.all(np.diff(np.log(found)) > np.log(high / low) / 8.0)


BARS = "Bars are standard errors: "


@pytest.mark.parametrize(("left", "said"), [
    (0.0009, BARS + "the means lie on the law within them."),
    (0.0035, BARS + "the means lie on the law within 4 of them."),
    (0.0045, BARS + "what lies beside the law is less than a tenth of it."),
    (0.02, "Beside the law something is left: 0.02 N m at velocity 0.5 rad/s, 20 standard errors"
           " (the bars)."),
])  # fmt: skip
def test_the_figure_of_a_law_says_that_something_else_is_left(left: float, said: str) -> None:
    """Error bars of 0.001 N m; less than a tenth of the law counts as nothing else."""
    x, zero = np.linspace(-1.0, 1.0, 9), np.zeros(9)
    none = Samples(zero, zero, zero, zero.astype(int))
    law = Curve("velocity", none, x, 0.05 * np.sign(x), zero + 0.001, against=False)
    after = Curve("velocity", none, x, left * (x == 0.5), zero + 0.001, against=False)
    assert beside_the_law(law, after, "velocity [rad/s]", "N m") == said


@pytest.mark.parametrize(("branch", "said"), [
    (0.0, ""),
    (0.004, ""),  # less than a tenth of what is shown
    (0.02, " Dots lie off the means, by 0.019 N m (RMS) at velocity 0 rad/s: that torque depends on"
           " more than the velocity, or passes too fast to be followed."),
])  # fmt: skip
def test_a_loop_in_the_figure_of_a_law_is_told(branch: float, said: str) -> None:
    """Noise of 0.001 N m about a straight line of 0.058 N m RMS, and two branches about rest."""
    rng = np.random.default_rng(1)
    x = np.tile(np.linspace(-1.0, 1.0, 400), 2)
    loop = np.repeat([branch, -branch], 400) * np.exp(-((x / 0.15) ** 2))
    torque = 0.1 * x + loop + rng.normal(0.0, 0.001, len(x))
    samples = Samples(x, torque, np.full(len(x), 1e6), np.repeat([0, 1], 400))
    curve = Curve("velocity", samples, *binned(samples, 21), against=False)
    assert off_the_means(curve, 0.058, "velocity [rad/s]", "N m") == said


def test_the_first_of_several_recordings_is_drawn_by_its_own_clock() -> None:
    """The times in the sentences can be found in the figure."""
    stamp = 1_790_000_000.0  # s, of a calendar: too long for an axis
    assert figures.one_after_the_other([(0.4, 5.0), (7.0, 3.0), (0.1, 2.0)]) == [0.4, 5.4, 8.4]
    assert figures.one_after_the_other([(stamp + 0.5, 5.0), (7.0, 3.0)]) == [0.5, 5.5]
    assert figures.one_after_the_other([(stamp + 0.5, 5.0)]) == [stamp + 0.5]


LAW = pytest.mark.long("test_decision.py draws others, by the same code; lost: its figure")


@LAW
@pytest.mark.parametrize("seconds", [(9.0, 12.0)])
def test_a_stribeck_curve_is_drawn_with_the_level_on_which_it_stands(decided: Decided) -> None:
    """The sentence names the breakaway torque, so the figure shows it."""
    d = decided(reality.Machine(coulomb=0.02, breakaway=0.06, stribeck=0.3), None, KNOWN[0])
    (k,) = (k for k, f in enumerate(d.findings) if f.effect == "stribeck")
    assert all(f.effect == "stribeck" for f in d.findings)
    means = _series(_of(d, "law", k), 0, "means")
    fast = np.abs(means.x) > 1.5
    assert np.allclose(np.abs(means.y[fast]), 0.02, atol=0.002)
    assert np.max(np.abs(means.y)) > 0.025, "passed in less than an observer remembers"


def test_a_friction_that_falls_within_a_small_part_of_the_speeds_is_drawn_up_to_there() -> None:
    """Of an arm at up to 5.7 rad/s, whose friction fell within 0.09, the law had been over time."""
    v = 5.7 * np.sin(np.linspace(0.0, 60.0, 40_000))
    torque = np.sign(v) * np.exp(-((v / 0.09) ** 2))
    samples = Samples(v, torque, np.ones_like(v), np.arange(len(v)) // 100)
    whole = Curve(Axis("velocity"), samples, *binned(samples), against=False)
    found: Any = SimpleNamespace(parameters={"velocity": SimpleNamespace(value=0.09)})
    assert whole.explained < laws.SHOWN and laws._is_slow(found, whole.axis)
    slow = laws._up_to(whole, laws.SLOW_SPEEDS * 0.09)
    assert slow.explained > 0.9 and np.ptp(slow.samples.x) < 1.1
    found.parameters = {}
    assert not laws._is_slow(found, whole.axis)


@pytest.mark.parametrize(("unit", "word"), [("N", "force"), ("N m", "torque"), ("A", "torque")])
def test_the_title_of_a_law_calls_a_force_what_its_axis_does(unit: str, word: str) -> None:
    found: Any = SimpleNamespace(effect="ripple")
    sides: Any = SimpleNamespace(by_law=True, lacking="calibrated model")
    assert laws._title(found, 1, sides, unit).startswith(f"Joint 1: {word} of ripple: ")
    sides.by_law = False
    lacks = f"Joint 1: {word} that the calibrated model lacks, by ripple"
    assert laws._title(found, 1, sides, unit) == lacks
    assert torque_label(unit) == f"{word} [{unit}]"


@LAW
def test_a_law_with_memory_is_drawn_over_time(decided: Decided) -> None:
    """The torque of a delay is no curve over any variable."""
    d = decided(reality.Machine(delay=0.006))
    (found,) = d.findings
    assert found.effect in ("delay", "lag")
    chart = _of(d, "law", 0)
    (panel,) = chart.panels
    # the law's own torque is not what a model lacks that is fitted without it
    own = f"torque of {found.effect}: the improved model without it and with it"
    assert chart.title == f"Joint 1: {own}, where it acts most"
    lacks = next(c for c in charts(d) if c.name == "torque_joint1").panels[0].title
    assert lacks.startswith("Joint 1: torque that the calibrated model lacks along the recordings")
    assert panel.xlabel == "time [s]"
    before, law, after = panel.series
    assert np.nanstd(after.y) < 0.2 * np.nanstd(before.y)
    assert np.nanstd(before.y - law.y) < 0.2 * np.nanstd(before.y)


@pytest.mark.parametrize("seconds", [(9.0, 12.0)])
def test_without_a_claim_every_figure_shows_one_model(decided: Decided) -> None:
    """Terms that only improve the fit are in no figure, since the text compares with no improved
    model.
    """
    d = decided(reality.Machine(wave=0.02))
    assert d.verdict == "unexplained"
    for chart in charts(d):
        for panel in chart.panels:
            assert "improved" not in [s.label for s in panel.series]


def test_windows_at_rest_do_not_stretch_the_axis_of_errors(
    coarse: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A window without motion is predicted to the last digit."""
    monkeypatch.setattr(figures, "window_error", lambda *_: np.zeros(3000))
    rms = _of(coarse, "fit").panels[1]
    assert rms.level is not None
    assert all(np.min(s.y) > 0.1 * rms.level[0] for s in rms.series)


def test_the_error_of_a_joint_is_compared_with_its_own_noise_floor(coarse: Diagnosis) -> None:
    """Not with that of joint 1, which may have another unit: here a thousandth."""
    other = replace(coarse, noise_floor=1e-3 * coarse.noise_floor)
    assert _of(other, "fit").panels[1].level == (coarse.noise_floor, "noise floor")
    assert figures.SENSOR_LEFT in _of(other, "white").note
    assert "model errs by" in _of(other, "white").note, "whiteness tells no size"


@pytest.mark.long("test_two_sensors.py finds the spring; lost: the figure of its torsion")
def test_what_two_sensors_show_of_a_spring_is_drawn_as_its_torsion(tmp_path: Path) -> None:
    """The torsion is drawn over the transmitted torque: the slope is the compliance in the
    sentence.
    """
    machine = reality.Machine(both_sides=True, load=0.006, soft=60.0, resolution=FINE)
    files = []
    for seed in (1, 2):
        rows = reality.simulate(machine, reality.multisine(9.0, RATE, seed, high=8.0), RATE)
        files.append(reality.save(tmp_path / f"run{seed}.csv", rows))
    model = reality.model_file(tmp_path / "model.toml", RATE, *KNOWN, resolution=FINE)
    text = model.read_text()
    assert 'position = "q"' in text
    model.write_text(text.replace('position = "q"', 'position = "q"\nposition_load = "ql"'))
    d = diagnose(files[0], model, files[1], jobs=1)
    (k,) = (k for k, f in enumerate(d.findings) if f.effect == "elasticity")
    chart = _of(d, "law", k)
    line, left = _series(chart, 0, "line"), _series(chart, 1, "means")
    assert chart.panels[0].ylabel == "torsion [rad]" and "torque" in chart.panels[0].xlabel
    stiffness = d.findings[k].parameters["stiffness"].value
    slope = float(np.polyfit(line.x, line.y, 1)[0])
    assert abs(slope) == pytest.approx(1.0 / stiffness, rel=0.05)
    assert np.max(np.abs(left.y)) < 0.1 * np.max(np.abs(line.y))


def test_an_unclaimed_torque_is_drawn_over_the_variable_it_depends_on() -> None:
    """It is drawn over time alone where it is no curve over any variable."""
    rng = np.random.default_rng(0)
    t = np.arange(4000) / 500.0
    q, v = np.sin(t), np.cos(t)
    variables = {"position": q, "velocity": v, "acceleration": -q, "command": rng.normal(size=4000)}
    drawn = {}
    for name, torque in (("wave", np.sin(5 * q)), ("noise", rng.normal(size=4000))):
        lacks = Missing(t, torque + 0.1 * rng.normal(size=4000), np.full(4000, 0.1), variables)
        given = parse_model(tomllib.loads(MODEL))
        drawn[name] = unclaimed_chart(SimpleNamespace(missing={1: [lacks]}, given=given), 1)  # type: ignore[arg-type]
    assert drawn["noise"] is None and drawn["wave"] is not None
    means = _series(drawn["wave"], 0, "means")
    assert means.spread is not None and drawn["wave"].panels[0].xlabel == "position [rad]"
    off = (means.y - np.sin(5 * means.x)) / np.hypot(means.spread, 0.02)  # bins of 0.05 rad
    assert np.mean(np.abs(off) < 3.0) > 0.9


@pytest.mark.parametrize("turns", [1.0, 20.0])
def test_bins_of_a_torque_without_a_law_are_finer_than_the_waves_that_describe_it(
    turns: float,
) -> None:
    """40 bins turned 14 waves per turn into noise. Over many turns the waves are laid over one
    another.
    """
    rng = np.random.default_rng(0)
    x = rng.uniform(0.0, turns * 2 * np.pi, 20000)
    torque = np.sin(14 * x) + 0.1 * rng.normal(size=20000)
    samples = Samples(x, torque, np.ones(20000), np.arange(20000) // 500)
    plain = Curve(Axis("position"), samples, *binned(samples), False)
    curve, period = in_waves(plain, [2 * np.pi / 14])
    assert period == (0.0 if turns == 1.0 else 2 * np.pi / 14)
    assert np.all(np.abs(curve.mean - np.sin(14 * curve.at)) < 0.1)
    assert np.max(curve.mean) > 0.85 and np.max(np.diff(curve.at)) <= 2 * np.pi / 14 / 8
    assert in_waves(plain, []) == (plain, 0.0)


def test_the_line_of_a_law_is_not_drawn_where_there_is_no_data() -> None:
    at = np.array([0.0, 0.1, 0.2, 0.9, 1.0, 1.2])
    x, y = broken(at, np.sin(at))
    assert np.flatnonzero(np.isnan(y)).tolist() == [3]
    assert np.array_equal(x[~np.isnan(y)], at)
    one = np.array([0.5])
    assert np.array_equal(broken(one, one)[0], one)
