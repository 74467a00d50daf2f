"""Which column of a recording a begun model takes for the command, and what it asks of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from drafts import N, model_of, recording

from zendsp.physics.files.draft import draft_model
from zendsp.recording import Table


def test_an_effort_that_is_always_zero_is_no_command_where_another_column_moves() -> None:
    columns = recording()
    bag = {
        "t": columns["t"],
        "joint_states.elbow.position": columns["q"],
        "joint_states.elbow.effort": np.zeros(N),  # a robot without torque sensors
        "effort_cmd.data": columns["tau"],
    }
    draft = draft_model(Table(bag, {}, {}, Path("bag")))
    assert model_of(draft.text).columns["command"] == "effort_cmd.data"


@pytest.mark.parametrize("beside", [True, False])
def test_a_command_that_is_the_position_in_its_numbers_is_asked_about(beside: bool) -> None:
    """As ``writetable`` has it: Command was the set value, and a spring of 0.16 N m/rad^3 with a
    confidence of 96 % came of it.
    """
    columns = recording()
    table = {"t": columns["t"], "Position": columns["q"], "Command": 1.07 * columns["r"]}
    table |= {"Current": columns["tau"]} if beside else {}
    draft = draft_model(Table(table, {}, {}, Path("run.csv")))
    asked = "\n".join(draft.questions)
    assert "Command is all but equal to Position" in asked
    model = model_of(draft.text).columns
    assert model["command"] == ("Current" if beside else "Command"), asked
    assert model.get("reference") == ("Command" if beside else None)
    torque = draft_model(Table({**columns, "i": columns["tau"]}, {}, {}, Path("run.csv")))
    assert model_of(torque.text).columns["command"] == "tau"
    assert "all but equal" not in torque.text


@pytest.mark.parametrize(("computed", "command", "measured", "asked"), [
    ("tau_computed", "tau_cmd", "", "is tau_cmd all that the drive was told, every compensation"
     " included? Or else tau_computed (11% apart): then write that one here"),
    ("tau_computed", "tau", "", "Or else tau_computed (11% apart)"),
    ("tau_1st", "tau_all", "", "is tau_1st all that the drive was told, every compensation"
     " included? Or else tau_all (12% apart)"),
    ("tau_computed", "", "tau_measured", "is tau_computed all that the drive was told, every"
     " compensation included? tau_measured is 12% apart from it."),
    ("", "tau_cmd", "tau_measured", ""),
])  # fmt: skip
def test_it_is_asked_whether_a_torque_is_the_whole_command(
    computed: str, command: str, measured: str, asked: str
) -> None:
    """Without its friction compensation a computed torque was taken for the command, silently."""
    columns = recording()
    tau = columns.pop("tau")
    every = {computed: tau - 0.1 * np.sign(np.gradient(columns["r"])), command: tau, measured: tau}
    columns |= {name: values for name, values in every.items() if name}
    draft = draft_model(Table(columns, dict.fromkeys(every, "N m"), path=Path("run.csv")))
    said = [question for question in draft.questions if "all that the drive was told" in question]
    assert len(said) == bool(asked) and asked in "".join(said), said
    taken = "tau_1st" if computed == "tau_1st" else command or computed
    assert model_of(draft.text).columns["command"] == taken
