"""Drawing, reading, sealing and revealing what a machine conceals."""

from __future__ import annotations

import hashlib
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from plants import Plant, follow
from test_machines import CENTRE, GAINS

import zendsp
from zendsp.link.concealed import Concealment
from zendsp_protocol.errors import Refused
from zendsp_target.concealed.draw import DRAWS, MACHINES, NAMED, draw
from zendsp_target.concealed.load import load_concealed
from zendsp_target.concealed.sealed import EFFECTS, Concealed, ConcealedEffect

Array = np.ndarray  # type: ignore[type-arg]
SPEED = {"imi_planar": 0.4, "pendulum": 0.4, "wam7": 0.3}  # Hz


SECONDS = {"imi_planar": 3.0, "pendulum": 3.0, "wam7": 1.0}


def work(machine: str, config: dict[str, str]) -> tuple[Array, Array]:
    """A few seconds of PD along sines on every joint: positions and commands."""
    kp, kd, amplitude = GAINS[machine]
    centre, n = CENTRE[machine], len(CENTRE[machine])
    text = "".join(f"{k} = {v}\n" for k, v in config.items()) + "".join(
        f"q{j + 1} = {x}\n" for j, x in enumerate(centre)
    )
    frequency = SPEED[machine] * (1 + 0.15 * np.arange(n))
    with Plant(machine, text) as plant:
        rows = follow(
            plant,
            lambda t: centre + np.array(amplitude) * np.sin(2 * np.pi * frequency * t),
            kp,
            kd,
            SECONDS[machine],
        )
    return rows[:, 1 : 1 + n], rows[:, 1 + 2 * n :]


@pytest.fixture(scope="module")
def bare() -> dict[str, tuple[Array, Array]]:
    return {machine: work(machine, {"friction": "full"}) for machine in MACHINES}


# wam7 is tried on the effects that need care on light joints; the rest of the table is the same
# code
LIGHT = (
    "elasticity", "backlash", "inertia", "coupling", "hysteresis", "delay", "friction_drift",
    "quadratic_drag", "foreign",
)
# follow() sees the truth
CARRIED = [
    (m, e)
    for m in MACHINES
    for e in DRAWS
    if e not in MACHINES[m].excluded and (m != "wam7" or e in LIGHT) and e != "encoder_eccentricity"
]


@pytest.mark.parametrize(("machine", "effect"), CARRIED)
def test_a_drawn_effect_is_there_and_the_loop_still_works(
    bare: dict[str, tuple[Array, Array]], machine: str, effect: str
) -> None:
    q0, tau0 = bare[machine]
    hidden = draw(machine, 3, effect)
    joint = hidden.effects[0].joint - 1
    q, tau = work(machine, hidden.config())
    assert np.isfinite(q).all(), hidden.effects
    # the loop answers an effect with its command: by more than 2 % of the joint's friction, else
    # nobody could find it
    difference = np.abs(tau - tau0)[:, joint].max() / MACHINES[machine].joints[joint].friction
    assert difference > 0.02, (hidden.effects, difference)
    assert np.abs(q - q0).max() < 1.2, (hidden.effects, np.abs(q - q0).max(axis=0))


def test_every_effect_of_the_table_can_be_drawn_and_is_known_to_the_machine_in_c() -> None:
    assert set(DRAWS) == set(EFFECTS)
    for machine in MACHINES:
        for effect in DRAWS:
            if effect not in MACHINES[machine].excluded:
                hidden = draw(machine, 1, effect)
                with Plant(
                    machine, "".join(f"{k} = {v}\n" for k, v in hidden.config().items())
                ) as plant:
                    plant.torque(np.zeros(plant.joints))


def test_the_same_seed_draws_the_same_effects_and_another_seed_others() -> None:
    assert draw("imi_planar", 17).effects == draw("imi_planar", 17).effects
    many = {draw("imi_planar", seed).effects[0].effect for seed in range(300)}
    assert many == set(NAMED), "every named effect comes up"
    joints = [draw("imi_planar", seed).effects[0].joint for seed in range(100)]
    assert 30 < joints.count(1) < 70


def test_the_seal_binds_the_truth_and_does_not_tell_it() -> None:
    one, other = draw("imi_planar", 17), draw("imi_planar", 17)
    assert (
        one.effects == other.effects and one.seal() != other.seal()
    ), "the nonce keeps a list of hashes from finding it"
    assert hashlib.sha256(one.record_text().encode()).hexdigest() == one.seal()
    for changed in (
        replace(one, machine="pendulum"),
        replace(one, friction="plain"),
        replace(one, effects=()),
    ):
        assert changed.seal() != one.seal()


def test_no_effect_or_several_effects_can_be_drawn() -> None:
    pair = load_concealed("seed:4,count=2,friction=plain", "imi_planar")
    assert len({e.effect for e in pair.effects}) == 2 and pair.friction == "plain"
    assert load_concealed("seed:4,count=0", "imi_planar").effects == ()
    assert load_concealed(None, "imi_planar").config() == {"friction": "full"}
    chosen = load_concealed("seed:4,effect=ripple,joint=2", "imi_planar").effects[0]
    assert (chosen.effect, chosen.joint) == ("ripple", 2)


def test_a_payload_on_the_pendulum_is_inertia_and_gravity_of_one_mass() -> None:
    inertia, gravity = load_concealed("seed:9,effect=payload", "pendulum").effects
    arm = 9.81 * inertia.parameters["amount"] / gravity.parameters["torque"]
    assert (inertia.effect, gravity.effect) == ("inertia", "gravity") and 0.08 < arm < 0.16


def test_effects_are_read_from_toml_and_json_in_the_form_of_a_model_file(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(
        'friction = "plain"\n[[effect]]\nkind = "coupling"\njoint = 2\nfrom_joint = 1\n'
        'law = "viscous"\ncoefficient = { value = 0.4 }\n'
    )
    (tmp_path / "a.json").write_text(
        json.dumps({"effect": [{"kind": "delay", "joint": 1, "time": 0.003}]})
    )
    toml = load_concealed(str(tmp_path / "a.toml"), "imi_planar")
    other = load_concealed(str(tmp_path / "a.json"), "pendulum")
    assert (
        toml.config()["effect1"] == "coupling joint=2 from_joint=1.0 law=2.0 coefficient=0.4"
        and toml.friction == "plain"
    )
    assert toml.effects[0].told()["parameters"]["law"]["value"] == "viscous"
    assert other.effects[0].parameters == {"time": 0.003}


@pytest.mark.parametrize(
    ("spec", "machine", "words"),
    [
        ("seed:x", "imi_planar", "expected seed:N"),
        ("seed:1,colour=red", "imi_planar", "colour in 'seed:1,colour=red'"),
        ("seed:1,effect=magic", "imi_planar", "cannot carry 'magic'"),
        ("seed:1,effect=coulom", "imi_planar", "did you mean coulomb?"),
        ("seed:1,effect=coupling", "pendulum", "pendulum cannot carry 'coupling'"),
        ("seed:1,joint=3", "imi_planar", "joint 3; imi_planar has joints 1 to 2"),
        ("seed:1", "/home/me/arm.c", "nothing can be drawn for"),
        ("nothing.toml", "imi_planar", "no file nothing.toml"),
    ],
)
def test_an_effect_that_cannot_be_concealed_is_refused_with_those_that_can(
    spec: str, machine: str, words: str
) -> None:
    with pytest.raises(Refused, match=words.replace("(", r"\(")):
        load_concealed(spec, machine)


def test_nothing_that_a_host_can_ask_tells_the_effect_before_the_reveal() -> None:
    """Over a real link: neither the name nor the numbers of the effect are in any answer."""
    hidden = draw("imi_planar", 17, "ripple", 2).effects[0].told()
    with zendsp.local(
        "imi_planar", clock="fast", options=["--concealed", "seed:17,effect=ripple,joint=2"]
    ) as target:
        seal = target.seal()
        target.download("inverse_dynamics.c")
        target.start(ticks=50)
        answers: list[Any] = [
            target.request(verb)
            for verb in (
                "info", "status", "machine", "limits", "variables", "builtins", "program", "log",
                "drive_status",
            )
        ]
        answers.append(target.request("read", names=[v.name for v in target.request("builtins")]))
        told = repr(answers).lower()
        for word in (
            "ripple",
            "seed",
            "conceal",
            "friction = ",
            *(
                f"{p['value']:g}"
                for p in hidden["parameters"].values()
                if len(f"{p['value']:g}") > 4
            ),
        ):
            assert word not in told, word
        truth = target.reveal()
    assert truth.sha256 == seal and truth.source == "seed:17"
    assert [(e["effect"], e["joint"]) for e in truth.effects] == [("ripple", 2)]
    assert truth.effects == (hidden,)


def test_the_truth_of_a_joint_that_slides_is_told_in_newton() -> None:
    """The record that is sealed has the units of a joint that turns."""
    hidden = [
        ConcealedEffect("coulomb_asymmetry", joint, {"level_pos": 4.0, "level_neg": 9.0})
        for joint in (1, 2)
    ]
    sealed = Concealed("crane", tuple(hidden), "hidden.toml")
    joints = tuple(SimpleNamespace(unit=unit) for unit in ("rad", "m"))
    answers = {
        "reveal": SimpleNamespace(record=sealed.record_text(), sha256=sealed.seal(), tick=0),
        "machine": SimpleNamespace(joints=joints),
    }
    asked: Any = SimpleNamespace(request=answers.__getitem__, insist=None)
    turns, slides = Concealment(asked).reveal().effects
    assert turns == hidden[0].told() and turns["parameters"]["level_neg"]["unit"] == "N m"
    assert slides["parameters"]["level_neg"] == {"value": 9.0, "unit": "N"}
