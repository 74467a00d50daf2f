"""Limits are checked before anything is saved; files come back as they were; forms and options come
from one registry.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from zendsp.cli.reference import command
from zendsp.errors import ReferenceError_
from zendsp.reference import (
    KINDS,
    MACHINES,
    Reference,
    inverse_kinematics,
    load_machine,
    load_reference,
    make_circle,
    make_from_file,
    make_limited,
    make_reference,
    plot_reference,
    save_reference,
)
from zendsp.reference.kind import MOVE_TIME
from zendsp.reference.limits import Limits


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"position": 2.3}, r"joint 2: position 2.3 rad at t = 0.005 s, limit 2.15 rad"),
        ({"speed": -10.0}, r"joint 2: speed -10 rad/s at t = 0.005 s, limit -9.42 rad/s"),
        (
            {"acceleration": 150.0},
            r"joint 2: acceleration 150 rad/s\^2 at t = 0.005 s, limit 140 rad/s\^2",
        ),
        ({"torque": 40.0}, r"joint 2: torque 40 N m at t = 0.005 s, limit 39.2 N m"),
    ],
)
def test_nothing_is_saved_beyond_a_limit_and_the_error_names_it(
    tmp_path: Path, change: dict[str, float], message: str
) -> None:
    x = {name: np.zeros((10, 2)) for name in ("position", "speed", "acceleration", "torque")}
    for name, value in change.items():
        x[name][5, 1] = value
    mode = "torque" if "torque" in change else "position"
    tau = x["torque"] if mode == "torque" else None
    reference = Reference(
        x["position"], 0.001, x["speed"], x["acceleration"], tau, machine="imi_planar", mode=mode
    )
    with pytest.raises(ReferenceError_, match=message):
        save_reference(reference, tmp_path / "no.mat")
    assert not list(tmp_path.iterdir())


def test_a_move_of_one_sample_is_no_step() -> None:
    """1 rad in 1 ms had been within the limits, where 2 ms were not."""
    arm = load_machine("imi_planar")
    with pytest.raises(ReferenceError_, match=r"joint 1: speed 1000 rad/s at t = 0\.001 s"):
        arm.check(make_reference("point_to_point", arm, duration=0.001))
    arm.check(make_reference("step", arm))


def test_torque_of_a_motion_is_limited_though_it_has_no_feed_forward() -> None:
    fast = np.zeros((10, 2))
    # rad/s^2, below the limit of acceleration; 3.957 kg m^2 · 54 + nothing = 213.7 N m on joint 1
    fast[5, 0] = 54.0
    torque = load_machine("imi_planar").torque(
        Reference(np.zeros((10, 2)), 0.001, np.zeros((10, 2)), fast)
    )
    assert torque[5] == pytest.approx([(3.473 + 2 * 0.242) * 54.0, (0.196 + 0.242) * 54.0])


@pytest.mark.parametrize("kind", ["circle", "multisine", "torque_law"])
def test_a_saved_reference_comes_back_equal(tmp_path: Path, kind: str) -> None:
    made = make_reference(kind, "imi_planar")
    back = load_reference(save_reference(made, tmp_path / "a"))
    for name in ("q", "qd", "qdd", "tau"):
        x, y = getattr(made, name), getattr(back, name)
        assert (x is None and y is None) or np.array_equal(x, y)
    for name in ("sample_time", "kind", "machine", "mode", "cyclic", "unit"):
        assert getattr(made, name) == getattr(back, name)
    assert json.loads(json.dumps(made.parameters)) == back.parameters
    assert np.array_equal(make_reference(kind, "imi_planar", **_given(back)).q, made.q)


def _given(reference: Reference) -> dict[str, object]:
    """The stored parameters that the kind takes: enough to plan the motion again."""
    names = {p.name for p in KINDS[reference.kind].parameters}
    return {k: v for k, v in reference.parameters.items() if k in names}


def test_a_table_of_another_rate_is_resampled_without_loss_of_shape(tmp_path: Path) -> None:
    t = np.arange(0, 2.0001, 0.01)
    lines = ["t,q1,q2"] + [f"{x!r},{float(np.sin(x))!r},{float(np.cos(x))!r}" for x in t.tolist()]
    (tmp_path / "way.csv").write_text("\n".join(lines))
    reference = make_from_file(load_machine("imi_planar"), path=str(tmp_path / "way.csv"))
    assert reference.samples == 2001
    # cubic splines err by h^4/384 of the fourth derivative inside, more at the ends
    assert reference.q[:, 0] == pytest.approx(np.sin(reference.t), abs=1e-8)
    assert reference.qd[100:-100, 1] == pytest.approx(-np.sin(reference.t[100:-100]), abs=1e-6)


@pytest.mark.parametrize(
    "head",
    [
        "t [ms];q1 [deg];q2 [deg]\n",  # units in the names, decimal commas
        "Zeit;q1;q2\nms;deg;deg\n",  # a row of units, another language
        "t [ms];q[0] [deg];q[1] [deg]\n",  # as recordings count joints
    ],
)
def test_a_foreign_table_comes_in_with_its_units_and_commas(tmp_path: Path, head: str) -> None:
    (tmp_path / "way.csv").write_text(head + "0;0;-1\n10;0,5;-1,5\n20;1,0;-2\n30;1,5;-2,5\n")
    made = make_from_file(load_machine("imi_planar"), path=str(tmp_path / "way.csv"))
    assert made.duration == pytest.approx(0.03)
    assert np.rad2deg(made.q[[0, 10, 30]]) == pytest.approx(
        np.array([[0.0, -1.0], [0.5, -1.5], [1.5, -2.5]])
    )


def test_bad_files_get_one_clear_sentence(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,x\n0,1\n1,2\n")
    (tmp_path / "b.csv").write_text("t,q1,q2\n0,1,1\n0,2,2\n")
    (tmp_path / "c.mat").write_bytes(b"this is no MAT file at all" * 20)
    (tmp_path / "e.mat").write_bytes(b"\x00\x01\x02garbage")
    (tmp_path / "f.csv").write_text("t,q1 [V],q2 [V]\n0,1,1\n1,2,2\n")
    (tmp_path / "g.csv").write_text("t,q1,q2\n0,1,1\n0.001,2,\n0.002,3,3\n")
    (tmp_path / "h.csv").write_text("t,q1,q3\n0,1,1\n1,2,2\n")
    arm = load_machine("imi_planar")
    for name, words in (
        ("a.csv", "no column q"),
        ("b.csv", "time does not increase at row 1"),
        ("c.mat", "not a readable MAT file"),
        ("d.mat", "no such file"),
        ("e.mat", "not a readable MAT file"),
        ("f.csv", "column q1 is in V; a reference has it in rad or m"),
        ("g.csv", "column q2 is no finite number in row 1"),
        ("h.csv", "q1, q3 are not numbered 1 to 2"),
    ):
        with pytest.raises(ReferenceError_, match=words):
            make_from_file(arm, path=str(tmp_path / name))


def test_out_of_reach_names_the_point_and_the_ring() -> None:
    arm = load_machine("imi_planar")
    with pytest.raises(
        ReferenceError_, match=r"\(0.8, 0\) m is 0.8 m from the base .* from 0.02 to 0.7 m"
    ):
        inverse_kinematics(arm, np.array([0.8, 0.0]), "positive")
    with pytest.raises(ReferenceError_, match="outstretched or folded"):
        make_circle(arm, radius=0.1, x=0.6, y=0.0)


def test_two_elbow_solutions_reach_the_same_point_and_no_third_exists() -> None:
    arm = load_machine("imi_planar")
    a, b = (inverse_kinematics(arm, np.array([0.3, 0.4]), elbow) for elbow in ("positive",
        "negative"))  # type: ignore[arg-type]
    assert a[1] == pytest.approx(-b[1]) and a[0] != pytest.approx(b[0])


def test_values_from_a_form_are_checked_against_type_bounds_and_choices() -> None:
    for given, words in (
        ({"radius": "x"}, 'radius is "x"; expected a number'),
        ({"x": "1e999"}, "x is inf m; expected a finite number"),
        ({"radius": 0.5}, "radius is 0.5 m; expected 0.0001 … 0.35"),
        ({"elbow": "up"}, 'elbow is "up"; expected one of positive, negative'),
        ({"turns": 1.5}, "turns is 1.5; expected a whole number"),
        ({"speed": 1}, "circle has no parameter speed"),
    ):
        with pytest.raises(ReferenceError_, match=words):
            make_reference("circle", "imi_planar", **given)
    with pytest.raises(ReferenceError_, match="goal has 3 numbers; imi_planar has 2"):
        make_reference("lspb", "imi_planar", goal="1,2,3")
    says = "circle is planned for machines of kind planar2r; wam7 is of kind dh, for which .* lspb"
    with pytest.raises(ReferenceError_, match=says):
        make_reference("circle", "wam7")


def test_every_parameter_of_every_kind_is_ready_for_a_form() -> None:
    for kind in KINDS.values():
        for parameter in kind.parameters:
            assert parameter.description.endswith(".") and parameter.name.isidentifier()
            for machine in (load_machine(name) for name in MACHINES):
                default = parameter.default_for(machine)
                if kind.fits(machine) and parameter.type != "path" and parameter != MOVE_TIME:
                    parameter.parse(default, machine)


def test_a_broken_limit_is_told_in_the_unit_of_its_joint() -> None:
    """It read "position 0.2 rad or m, limit 0.15 rad or m"."""
    limits = Limits([-1.0, -0.15], [1.0, 0.15], [1.0, 1.0], [np.inf, np.inf], [9.0, 9.0])
    crane = make_limited("crane", 0.001, [0.0, 0.0], limits, "rad or m", ("rad", "m"))
    q = np.linspace([0.0, 0.0], [1.2, 0.2], 11)
    found = [str(one) for one in crane.find_violations(Reference(q, 0.1, unit="rad or m"))]
    assert "joint 1: position 1.2 rad at" in found[0] and "limit 1 rad" in found[0]
    assert "joint 2: position 0.2 m at" in found[1] and "limit 0.15 m" in found[1]
    assert "joint 1: speed 1.2 rad/s" in found[2]


def test_every_default_is_within_the_limits_of_a_machine_with_little_room() -> None:
    """Of a joint that slides, the goal lay beyond the end of its travel."""
    limits = Limits(
        np.array([-0.1, -2.6, -0.05]), np.array([0.15, 2.6, 0.35]), np.array([0.5, 6.0, 2.0]),
        np.full(3, np.inf), np.full(3, np.inf),
    )  # fmt: skip
    crane = make_limited("crane", 0.001, [0.0, 0.0, 0.1], limits, "rad or m")
    for kind in ("multisine", "chirp", "step", "lspb", "point_to_point"):
        planned = make_reference(kind, crane)
        crane.check(planned)
        assert np.all(np.ptp(planned.q, axis=0)[: 1 if kind in ("chirp", "step") else 3] > 0.01)


def test_command_line_plans_saves_draws_and_refuses(tmp_path: Path) -> None:
    runner = CliRunner()
    out, picture = tmp_path / "c.mat", tmp_path / "c.png"
    args = [
        "circle", "--machine", "imi_planar", "--radius", "0.1", "--out", str(out), "--plot",
        str(picture), "--json",
    ]
    result = runner.invoke(command, args, catch_exceptions=False)
    told = json.loads(result.output)
    assert told["samples"] == 4501 and load_reference(out).parameters["radius"] == 0.1
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert runner.invoke(command, ["show", str(out)], catch_exceptions=False).exit_code == 0
    refused = runner.invoke(command, ["circle", "--x", "0.4", "--out", str(tmp_path / "no.mat")])
    assert isinstance(refused.exception, ReferenceError_) and not (tmp_path / "no.mat").exists()


def test_planning_and_drawing_say_what_they_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENDSP_PROGRESS", "lines")  # on a terminal: one line, in a pipe: nothing
    picture = tmp_path / "circle.png"
    words = ["circle", "--machine", "imi_planar", "--radius", "0.1", "--plot", str(picture)]
    done = CliRunner().invoke(command, words, catch_exceptions=False)
    told = done.stderr.splitlines()
    assert told == ["planning within the limits of imi_planar", f"drawing {picture}"]
    assert f"wrote {picture}" in done.stdout


def test_plot_has_one_axis_per_quantity_and_the_path_of_a_planar_tip() -> None:
    arm, pendulum = load_machine("imi_planar"), load_machine("pendulum")
    assert len(plot_reference(make_reference("circle", arm), arm).axes) == 5
    beside = plot_reference(make_reference("lspb", pendulum), pendulum).axes
    assert [axis.get_ylabel() for axis in beside][3:] == ["tau [N m]", "i [A]"]


def test_the_picture_tells_every_limit_and_its_legend_covers_no_curve() -> None:
    arm = load_machine("imi_planar")
    figure = plot_reference(make_reference("circle", arm, radius=0.15), arm)
    assert all(ax.get_legend() is None for ax in figure.axes[:4])
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.texts] == ["joint 1", "joint 2", "limit"]
    torque = figure.axes[3]
    dashed = {round(float(np.asarray(line.get_ydata())[0]), 1) for line in torque.lines[2:]}
    # 11 times what the circle asks
    assert torque.get_title(loc="right") == "limits beyond the picture: joint 1 ±245"
    assert dashed == {-39.2, 39.2}, "joint 2"


@pytest.mark.parametrize("share", [0.3, 0.7, 1.0])
@pytest.mark.parametrize(
    ("machine", "kind"),
    [
        ("imi_planar", "point_to_point"),
        ("imi_planar", "lspb"),
        ("pendulum", "lspb"),
        ("pendulum", "chirp"),
    ],
)
def test_a_motion_leaves_the_rest_of_every_limit_to_the_controller(
    machine: str, kind: str, share: float
) -> None:
    described = load_machine(machine)
    reference = make_reference(kind, described, headroom=share)
    used = {
        "speed": np.abs(reference.qd).max(0) / described.limits.speed,
        "acceleration": np.abs(reference.qdd).max(0) / described.limits.acceleration,
        "torque": np.abs(described.torque(reference)).max(0) / described.limits.torque,
    }
    most = max(np.nanmax(shares) for shares in used.values())
    assert most <= share * (1.0 + 1e-6), used
    assert reference.headroom == share and not described.find_violations(reference)


def test_headroom_is_kept_when_a_motion_is_checked_again() -> None:
    machine = load_machine("imi_planar")
    hasty = make_reference("point_to_point", machine, duration=0.0, headroom=1.0)
    assert not machine.find_violations(hasty)
    claimed = replace(hasty, parameters={**hasty.parameters, "headroom": 0.7})
    found = machine.find_violations(claimed)
    assert found and "headroom 0.7" in str(found[0])


@pytest.mark.parametrize("share", [0.0, 0.04, 1.01, "much"])
def test_a_headroom_that_is_none_is_refused(share: float | str) -> None:
    with pytest.raises(ReferenceError_, match="headroom"):
        make_reference("point_to_point", "imi_planar", duration=0.0, headroom=share)


def test_a_reference_that_cannot_be_written_leaves_nothing_half(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import scipy.io

    rest = Reference(np.zeros(3), 0.001)
    kept = save_reference(rest, tmp_path / "rest.mat").read_bytes()

    def full(path: Any, *_: Any, **__: Any) -> None:
        Path(path).write_bytes(b"the first part")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(scipy.io, "savemat", full)
    with pytest.raises(ReferenceError_, match=r"rest\.mat: cannot be written \(No space left"):
        save_reference(rest, tmp_path / "rest.mat")
    assert [p.name for p in tmp_path.iterdir()] == ["rest.mat"]
    assert (tmp_path / "rest.mat").read_bytes() == kept


@pytest.mark.parametrize("machine", ["imi_planar", "pendulum", "wam7"])
def test_a_move_whose_time_nobody_gave_is_calm_and_within_limits(machine: str) -> None:
    calm = make_reference("point_to_point", machine)
    assert calm.duration == pytest.approx(2.0)
    assert make_reference("point_to_point", machine, duration=0).duration < 1.0
    own = load_machine(machine)
    slow = replace(own, limits=replace(own.limits, speed=0.001 * own.limits.speed))
    long = make_reference("point_to_point", slow)
    assert long.duration > 2.0 and not slow.find_violations(long)


@pytest.mark.parametrize("kind", sorted(set(KINDS) - {"swing"}))
def test_the_example_in_the_help_of_each_kind_runs(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "motion.csv").write_text("t,q1,q2\n0,0.1,0.2\n0.5,0.15,0.25\n1,0.2,0.3\n")
    shown = CliRunner().invoke(command, [kind, "--help"]).output.partition("Example:")[2]
    words = shown.partition("Options")[0].split()
    assert words[:3] == ["zendsp", "reference", kind]
    said = CliRunner().invoke(command, words[2:])
    assert said.exit_code == 0 and (tmp_path / f"{kind}.png").exists(), said.output


def test_a_table_is_no_reference_and_how_one_is_made_of_it_is_said(tmp_path: Path) -> None:
    """SciPy's word was told: a MAT file that appears to be truncated."""
    table = tmp_path / "bad.csv"
    table.write_text("t,q1\n0,0\n1,1\n")
    with pytest.raises(ReferenceError_, match=f"from_file --path {table} -o motion.mat"):
        load_reference(table)


def test_one_number_for_several_joints_is_said_to_be_that_of_each(
    typed: Callable[..., tuple[object, str, str]],
) -> None:
    goal = "--goal 0.5 is taken for each of the 2 joints; a number of its own for each is written"
    words = "reference", "point_to_point", "--machine", "imi_planar", "--goal"
    assert typed(*words, "0.5")[2] == f"zendsp: {goal} --goal Q1,Q2\n"
    assert typed(*words, "0.5,0.2")[2] == ""
