"""What a prompt and a notebook show of each object: one line, and a table, a plot, a sentence."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from zendsp.diagnosis import Diagnosis, Estimate, Finding, FitTable
from zendsp.experiment.response import FrequencyResponse
from zendsp.experiment.result import Estimate as Measured
from zendsp.experiment.result import Result
from zendsp.link import Target, local
from zendsp.physics import parse_model
from zendsp.recording import Recording, Table
from zendsp.reference import Limits, load_machine, make_limited, make_reference, plot_reference
from zendsp.tui.scope import ticks
from zendsp_protocol.views import short


def _diagnosis() -> Diagnosis:
    model = parse_model({"mechanism": {"kind": "rotary", "parameters": {"inertia": 0.01}}})
    finding = Finding(
        "coulomb", 1, {"level": Estimate(0.05, 0.001, "N m")}, 0.97, 0.6, (), (),
        "Joint 1 lacks <Coulomb> friction.",
    )  # fmt: skip
    table = FitTable(3e-3, 2e-3, 1e-4)
    return Diagnosis(
        "missing", (finding,), (), (), "rad", table, table, 9e-5, (), None, 2.0, (),
        model, model, model,
    )  # fmt: skip


def test_every_repr_is_one_line_that_a_person_can_read() -> None:
    result = Result("breakaway", "Friction", "imi_planar", {"level": Measured(8.4, 0.1, "N m")})
    recording = Recording.from_columns({"q": np.zeros(5)}, 1e-3, units={"q": "rad"})
    assert repr(_diagnosis()) == "<Diagnosis missing: coulomb at joint 1 (97 %); 2.0 s>"
    assert repr(result) == "<Result breakaway on imi_planar: level 8.40 ± 0.10 N m>"
    table = Table({"t": np.zeros(5), "q": np.zeros((5, 2))}, {"t": "s"}, path=Path("a/run.csv"))
    assert repr(table) == "<Table run.csv: t [s], q; 5 rows>"
    many = Table({f"channel {k}": np.zeros(5) for k in range(60)})
    assert repr(many).startswith("<Table: 60 columns: channel 0, channel 1, ")
    for thing in (load_machine("imi_planar"), recording, many):
        assert len(repr(thing)) < 120 and "\n" not in repr(thing)


def test_a_notebook_shows_a_plot_where_nobody_has_imported_pyplot() -> None:
    """IPython asks the figure itself; it said <Figure size 900x310 with 1 Axes> and no more."""
    arm = load_machine("imi_planar")
    motion = make_reference("circle", arm)
    recording = Recording.from_columns({"q": np.zeros(5)}, 1e-3)
    few = np.array([1.0, 2.0])
    response = FrequencyResponse(
        few, few + 1.0j, few, few / 2.0, few, "tau", "q", "rad/(N m)", 3, recording
    )
    for figure in (recording.plot(), response.plot(), plot_reference(motion, arm)):
        shown: bytes = getattr(figure, "_repr_png_")()  # noqa: B009
        assert shown.startswith(b"\x89PNG")


def test_a_notebook_shows_findings_values_and_limits() -> None:
    shown = _diagnosis()._repr_html_()
    assert "Joint 1 lacks &lt;Coulomb&gt; friction. (confidence 97 %)" in shown
    assert "<td>0.0500 ± 0.0010 N m</td>" in shown and "<td>0.0001</td>" in shown
    result = Result("x", "Friction", "arm", {"level": Measured(8.4, 0.1, "N m")}, warnings=["hot"])
    assert "<td>8.40 ± 0.10 N m</td>" in result._repr_html_()
    assert "careful: hot" in result._repr_html_()
    shown = load_machine("imi_planar")._repr_html_()
    assert "<td>245</td>" in shown and "speed [rad/s]" in shown and "torque [N m]" in shown
    gantry = make_limited("g", 0.001, [0.0], Limits([-1.0], [1.0], [2.0], [3.0], [5.0]), "m")
    shown = gantry._repr_html_()
    assert "position [m]" in shown and "acceleration [m/s²]" in shown and "torque [N]" in shown


def test_a_recording_is_drawn_with_its_spikes_and_gaps() -> None:
    y = np.zeros(100_000)
    y[54_321] = 7.0
    recording = Recording.from_columns({"q": y}, 1e-3, units={"q": "rad"})
    shown = recording._repr_html_()
    assert shown.count("<polyline") == 1 and ">6</text>" in shown, "one sample in 100 000"
    assert ",8.0 " in shown, "the spike reaches the top of the frame"
    assert "q [rad]" in shown and len(shown) < 40_000
    y[40_000:60_000] = np.nan
    gap = Recording.from_columns({"q": y}, 1e-3)._repr_html_()
    assert gap.count("<polyline") == 2
    empty = replace(recording, t=recording.t[:0], data=recording.data[:0])
    assert "no samples yet" in empty._repr_html_()


def test_an_error_is_not_drawn_flat_under_the_position_or_the_torque() -> None:
    t = np.linspace(0.0, 1.0, 50)
    columns = {"q1": t, "q2": 0.5 * t, "e1": 1e-3 * t, "tau": 20.0 * t}
    units = {"q1": "rad", "q2": "rad", "e1": "rad", "tau": "N m"}
    shown = Recording.from_columns(columns, 1e-3, units=units)._repr_html_()
    heights = []
    for points in re.findall(r'points="([^"]*)"', shown):
        y = [float(point.partition(",")[2]) for point in points.split()]
        heights.append(max(y) - min(y))
    assert shown.count("<rect") == 3, "positions together, error and torque in lanes of their own"
    assert min(heights) >= 0.5 * max(heights) > 40.0, "px"


@pytest.fixture(scope="module")
def target() -> Iterator[Target]:
    """A machine here, with a program."""
    with local("imi_planar", clock="fast", options=["--speed", "20"]) as made:
        made.download("pd.c")
        yield made


def test_a_target_shows_its_state_and_completes_its_variables(target: Target) -> None:
    names = target._ipython_key_completions_()
    assert {"Kp1", "ref", "tau", "enc"} <= set(names)
    status = target.status()
    assert repr(status).startswith("<Status imi_planar: loaded") and len(repr(status)) < 150
    shown = target._repr_html_()
    assert "<td>Kp1</td><td>2000</td><td>N m/rad</td>" in shown
    assert "overruns, missed" in status._repr_html_()


def test_what_a_target_hands_out_is_a_line_at_a_prompt(target: Target) -> None:
    parts = (target.drives, target.variables, target.program(), target.limits(), target.info)
    for part in parts:
        said = repr(part)
        assert "\n" not in said and len(said) < 250 and " object at 0x" not in said, said
    assert repr(target.program()).startswith("<Program pd.c (")


def test_a_target_without_a_program_is_shown_too(target: Target) -> None:
    target.request("unload")
    try:
        assert "<table>" in target._repr_html_() and target._ipython_key_completions_() == []
    finally:
        target.download("pd.c")


def test_a_live_view_takes_names_as_they_come_and_draws(target: Target) -> None:
    target.start()
    with target.live("q", "tau", history=1.0) as view:
        assert view.columns == ("q[0]", "q[1]", "tau[0]", "tau[1]")
        assert view.next_block(20.0) is not None
        assert view.next_block(20.0) is not None
        shown = view._repr_html_()
        assert shown.count("<polyline") >= 4 and "q[0] [rad]" in shown
        assert re.search(r": \d+ rows>$", repr(view))
        view.lost = 3
        assert repr(view).endswith("rows, 3 more not shown (a recording keeps all)>")
    assert "closed" in repr(view)
    target.pause()


def test_what_a_target_lists_is_a_table_at_a_prompt_and_in_a_notebook() -> None:
    with local("imi_planar", clock="fast") as target:
        target.download("pd.c")
        known = target.variables()
        first, row = repr(known).splitlines()[:2]
        assert first.split() == ["VARIABLE", "TYPE", "KIND", "UNIT", "MIN", "MAX"]
        assert row.split(maxsplit=7) == [
            "Kp1", "double", "parameter", "N", "m/rad", "0", "20000", "proportional gain, joint 1",
        ]
        assert "<td>double[2]</td>" in known._repr_html_() and known["Kp1"].unit == "N m/rad"
        assert "<td>encoders</td>" in target.builtins()._repr_html_()
        assert repr(target.log()) == "none"
        sample = target.update(Kp1=400.0)
        assert repr(target.log()).splitlines()[1].split()[:4] == [str(sample), "Kp1", "2000", "400"]
        assert "<td>400</td>" in target.log()._repr_html_()
        reading = target.read(["Kp1", "q"])
        assert repr(reading).startswith(f"<Reading of sample {reading.tick}: Kp1 400, q [")
        assert "<td>Kp1</td><td>400</td>" in reading._repr_html_()


def test_the_denormal_tail_of_a_filter_is_displayed_as_zero() -> None:
    assert short(5e-324) == ticks.short(-3e-310) == ticks.number(5e-324) == "0"
    assert short([1e-20, -1e-56]) == "[1e-20, 0]"


def test_a_notebook_shows_an_expected_error_at_the_users_own_line(tmp_path: Path) -> None:
    """An unknown channel was 69 lines, most of them of zendsp itself."""
    pytest.importorskip("IPython")
    code = (
        "import zendsp\n"
        "rec = zendsp.Recording.from_columns({'q': [0.0, 1.0]}, 1e-3)\n"
        "def mine():\n"
        "    return rec['nothing']\n"
        "mine()\n"
    )
    command = [sys.executable, "-m", "IPython", "--quick", "--colors=NoColor", "-c", code]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=60, check=False,
        env=os.environ | {"IPYTHONDIR": str(tmp_path)},
    )  # fmt: skip
    shown = done.stdout + done.stderr
    assert "RecordingError: the recording has no channel 'nothing'; it has q" in shown
    assert "line 5" in shown and "line 4, in mine" in shown and "rec['nothing']" in shown
    assert "samples.py" not in shown and len(shown.strip().splitlines()) < 9, shown
