"""A machine without a description on the host plays references within the limits that its target
reports.
"""

from __future__ import annotations

import importlib.util
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from steps import Until, nobody
from textual.widgets import Select, Static

from zendsp.link import Rehearsal, local, rehearse
from zendsp.reference import (
    UNPREDICTED,
    Reference,
    load_machine,
    load_reference,
    make_reference,
    save_reference,
)
from zendsp.tui.app import ZendspApp
from zendsp.tui.link_port import LinkPort
from zendsp.tui.playing import Setup
from zendsp.tui.preflight import Condition, machine_of, preflight
from zendsp.tui.preview import columns_of, limits_of, peaks_of, views_of
from zendsp.tui.screens.reference import ReferenceScreen
from zendsp.tui.snapshot import Snapshot, Variable
from zendsp.tui.trial import Trial
from zendsp_protocol.messages import JointInfo, Limits, MachineInfo

ROOT = Path(__file__).parents[2]
LIMITS = Limits((-1.0, -2.0), (1.0, 2.0), (3.0, 4.0), (5.0, 6.0), (1e4, 1e4))
JOINTS = (JointInfo("shoulder", home=0.1), JointInfo("elbow", home=-0.2))


def _table(name: str) -> Variable:
    return Variable(name, "double", 2 * 10**5, "table", "rad", -9.0, 9.0, 0.0, "", columns=2)


def _seen(name: str = "arm", model: str = "", limits: Limits = LIMITS) -> Snapshot:
    """A target with an arm of two joints, enabled, with a program that plays tables."""
    return Snapshot(
        link="up", target="arm", machine=name, joints=2, state="loaded", drive="enabled", mine=True,
        explicit=True,
        rate_hz=500.0, position=(0.1, -0.2), variables=(_table("ref"),), limits=limits,
        described=MachineInfo(name, joints=JOINTS, model=model),
    )  # fmt: skip


class _Port:
    """A target of which a rehearsal finds no simulation."""

    def rehearse(self, *_: Any) -> Rehearsal:
        return Rehearsal(False, None, "there is no simulation of arm here")


def test_limits_home_and_sample_time_are_those_of_the_target() -> None:
    machine = machine_of(_seen())
    assert machine is not None and (machine.name, machine.joints) == ("arm", 2)
    assert machine.home.tolist() == [0.1, -0.2] and machine.sample_time == 0.002
    own = machine.limits
    assert (own.position_min.tolist(), own.position_max.tolist()) == ([-1.0, -2.0], [1.0, 2.0])
    assert (own.speed.tolist(), own.torque.tolist()) == ([3.0, 4.0], [5.0, 6.0])
    assert np.isinf(own.acceleration).all(), "which no target tells"
    assert machine_of(replace(_seen(), limits=None)) is None, "nobody knows yet"


def test_a_shipped_name_is_believed_only_where_it_is_that_machine() -> None:
    shipped = machine_of(_seen("imi_planar"))
    assert shipped is not None and shipped.modelled
    drawn = machine_of(_seen("imi_planar", model="/home/me/imi_planar.xml"))
    assert drawn is not None and not drawn.modelled, "a MuJoCo model that is called so"
    other = machine_of(_seen("pendulum"))
    assert other is not None and not other.modelled and other.joints == 2, "it has one joint"


def test_slides_are_in_metres() -> None:
    said = MachineInfo("gantry", joints=(JointInfo("x", unit="m"), JointInfo("y", unit="m")))
    machine = machine_of(replace(_seen("gantry"), described=said))
    assert machine is not None and machine.unit == "m"
    reference = make_reference("trapezoid", machine)
    assert reference.unit == "m"
    assert limits_of(machine)["m"] == [-2.0, -1.0, 1.0, 2.0]
    assert limits_of(machine)["m/s²"] == [], "what is not known is not drawn"


def test_a_reference_of_another_machine_is_told_beside_start(tmp_path: Path) -> None:
    machine = machine_of(_seen())
    assert machine is not None
    port: Any = _Port()
    for change, met, words in (
        ({}, True, "was planned for other, not for arm"),
        ({"unit": "m"}, False, "planned for other and is in m, arm is in rad"),
    ):
        made = replace(make_reference("point_to_point", machine), machine="other", **change)
        found = preflight(_seen(), (made,), (Path("w.mat"),), Setup(), False, Trial(), port)
        said = [c for c in found if words in c.text + c.advice]
        assert [c.met for c in said] == [met] and (said[0].warning or not met), found
        assert any("can be played" in c.text for c in found) == met, "told once"


class _Twin:
    """A target of which there is a simulation on this computer."""

    def rehearse(self, *_: Any) -> Rehearsal:
        return Rehearsal(True, None, "no limit is passed: torque 1 of 5 N m")


def _look(
    snapshot: Snapshot, folder: Path, trial: Trial, port: Any = None, **settings: Any
) -> list[Condition]:
    machine = machine_of(_seen())
    assert machine is not None
    reference = make_reference("point_to_point", machine, **settings)
    port = port or _Port()
    return preflight(snapshot, (reference,), (folder / "way.mat",), Setup(), False, trial, port)


def test_start_is_free_where_there_is_no_simulation_and_the_list_says_so(tmp_path: Path) -> None:
    trial, deadline = Trial(), time.monotonic() + 20.0
    found = _look(_seen(), tmp_path, trial)
    assert [c.text for c in found if not c.met] == ["tried on a simulated twin"]
    while not all(c.met for c in found):
        assert time.monotonic() < deadline, [c for c in found if not c.met]
        time.sleep(0.02)
        found = _look(_seen(), tmp_path, trial)
    seen = [c.text for c in found if c.warning]
    assert len(seen) == 2 and UNPREDICTED in seen[0]
    assert seen[1] == "not tried: there is no simulation of arm here"


def test_torque_that_the_twin_predicted_is_not_said_to_be_unpredicted(tmp_path: Path) -> None:
    trial, deadline = Trial(), time.monotonic() + 20.0
    found = _look(_seen(), tmp_path, trial, _Twin())
    assert any(UNPREDICTED in c.text for c in found), "so long as nobody has simulated it"
    while not all(c.met for c in found):
        assert time.monotonic() < deadline, [c for c in found if not c.met]
        time.sleep(0.02)
        found = _look(_seen(), tmp_path, trial, _Twin())
    texts = [c.text for c in found]
    assert "no limit is passed: torque 1 of 5 N m" in texts
    assert "within the limits of position and speed" in texts
    assert not any(c.warning for c in found), "nothing is left to be told"


def test_what_leaves_the_limits_of_the_target_cannot_start(tmp_path: Path) -> None:
    tighter = replace(_seen(), limits=Limits((-1.0, -0.3), *(getattr(LIMITS, n) for n in (
        "position_max", "speed_max", "torque_max", "command_max"))))  # fmt: skip
    found = _look(tighter, tmp_path, Trial(), goal=[0.5, -0.5])
    unmet = {c.text: c.advice for c in found if not c.met}
    assert "joint 2: position -0.5 rad" in unmet["within the limits"]


def test_torque_that_is_not_predicted_is_neither_drawn_nor_zero() -> None:
    machine = machine_of(_seen())
    assert machine is not None
    reference = make_reference("multisine", machine, amplitude=0.1)
    assert machine.torque(reference) is None
    assert "torque" not in views_of(columns_of(machine, reference, None))
    lines = peaks_of(machine, reference, None)
    assert [line[0][1].strip() for line in lines] == ["position", "velocity", "acceleration"]
    assert lines[2][1][1].rstrip().endswith("– %"), "no share of a limit that nobody knows"


def test_a_swing_shows_the_current_of_a_motor_whose_torque_constant_is_known() -> None:
    pendulum, arm = load_machine("pendulum"), load_machine("imi_planar")
    tau = np.array([[0.1762], [0.3524], [0.0]])
    swing = Reference(np.zeros((3, 1)), 0.001, tau=tau, mode="torque")
    columns = columns_of(pendulum, swing, pendulum.torque(swing))
    assert columns["current"][1] == "A"
    np.testing.assert_allclose(columns["current"][2], [[1.0], [2.0], [0.0]])
    peak = peaks_of(pendulum, swing, pendulum.torque(swing))[-1][1][1]
    assert peak.split() == ["2", "A", "44", "%"], "of the 0.8 N m that the motor may give"
    assert "current" not in columns_of(arm, make_reference("circle", arm), np.zeros((3, 2)))


async def test_the_reference_screen_begins_with_the_machine_of_the_target(
    tmp_path: Path, until: Until
) -> None:
    app = ZendspApp(nobody, folder=tmp_path, first="reference", frames=4.0)
    async with app.run_test(size=(120, 40)) as pilot:
        screen = app.screen
        assert isinstance(screen, ReferenceScreen)
        await until(pilot, lambda: screen.plan is not None, "planned for a shipped machine")
        screen.pull(_seen(), True)
        await until(pilot, lambda: screen.plan and screen.plan.machine.name == "arm", "for the arm")
        labels = [str(label) for label, _ in screen.query_one("#machine", Select)._options]
        assert labels[0] == "arm (target)" and "imi_planar" in labels
        check = " ".join(str(screen.query_one("#check", Static).render()).split())
        assert UNPREDICTED in check and "of the others that are known" in check
        plan = screen.plan
        assert plan is not None and plan.reference.machine == "arm"
        file = save_reference(plan.reference, tmp_path / "way", plan.machine)
        assert load_reference(file).machine == "arm"

        screen.pull(replace(_seen(), limits=replace_limits(speed_max=(0.1, 0.1))), True)
        await until(
            pilot,
            lambda: screen.plan and np.abs(screen.plan.reference.qd).max() <= 0.07 * (1 + 1e-9),
            "tighter limits are planned for at once",
        )
        screen.query_one("#machine", Select).value = "pendulum"
        await until(pilot, lambda: screen.plan and screen.plan.reference.joints == 1, "chosen")
        screen.pull(_seen(), True)
        await pilot.pause()
        assert screen.machine.name == "pendulum", "what was chosen stays"
        screen.open_reference(file)
        assert screen.machine.name == "arm"


def replace_limits(**changes: Any) -> Limits:
    return Limits(**{name: getattr(LIMITS, name) for name in LIMITS.__struct_fields__} | changes)


@pytest.mark.long("test_execute.py tries on a twin; lost: that it gets the target's options")
@pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs mujoco")
def test_a_mujoco_model_is_tried_on_a_twin_with_the_options_of_its_target(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def described(model: str) -> MachineInfo:
        return MachineInfo("arm", joints=JOINTS, model=model)

    model = ROOT / "tests" / "machines" / "models" / "bench_arm.xml"
    hidden = tmp_path / "hidden.toml"
    hidden.write_text('[[effect]]\nkind = "coulomb"\njoint = 1\nlevel = 0.5\n')
    options = ["--machine-option", "counts=20000", "--concealed", str(hidden)]
    with local(str(model), clock="fast", options=options) as target:
        target.download("joint_pd.c")
        snapshot = LinkPort(target).snapshot()
        machine = machine_of(snapshot)
        assert machine is not None and not machine.modelled
        assert np.isfinite(machine.limits.speed).all() and np.isfinite(machine.limits.torque).all()
        assert snapshot.described is not None and Path(snapshot.described.model) == model
        assert snapshot.described.options == ("counts=20000",), "and nothing of what is concealed"
        reference = make_reference("trapezoid", machine, joint=1, travel=0.1, speeds=[0.2])
        values = {"use_table": True, "row_rate": round(1.0 / reference.sample_time)}
        found = rehearse(target, reference.tables(), values, reference.duration + 3.0)
        assert found.good and {p.quantity for p in found.peaks} == {"torque", "speed"}
        far = np.array(machine.limits.position_max) + 0.5
        rows = np.linspace(reference.q[0], far, 500)
        tripped = rehearse(target, {"ref": rows}, values, 8.0)
        assert tripped.simulated and tripped.trip is not None
        monkeypatch.setattr(target, "machine", lambda: described("/there/is/no/arm.xml"))
        assert not rehearse(target, {}, {}, 1.0).simulated, "another computer's file"
        monkeypatch.setattr(target, "machine", lambda: described(__file__))
        assert not rehearse(target, {}, {}, 1.0).simulated, "no model: never run"
        assert target.status().tick == 0 and target.status().trip is None, "it was only read"
