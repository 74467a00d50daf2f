"""Mechanisms that act without a law of the library."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis import Diagnosis
from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide import believed, notes, nothing_named
from zendsp.diagnosis.decide import decide as decision
from zendsp.diagnosis.decide import propose as proposal
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.measure import structure as measure_structure
from zendsp.diagnosis.report.figures import charts
from zendsp.diagnosis.report.files import no_reference
from zendsp.diagnosis.report.laws import unknown_chart
from zendsp.physics.model import Model

Decided = Callable[..., Diagnosis]


@pytest.mark.usefixtures("searched_once")
def test_no_function_of_the_state_is_learned_from_a_joint_that_only_reverses(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measure_structure, "counted", lambda rec, *_: np.zeros(rec.n, bool))
    assert decided(reality.Machine()).verdict == "complete"


@pytest.mark.parametrize(("power", "law"), [(2.0, "quadratic_drag"), (3.0, "unknown")])
def test_a_law_is_named_where_a_neighbour_of_it_does_not_predict_better(
    power: float, law: str, decided: Decided
) -> None:
    """Drag with the square of the speed, and with its cube."""
    d = decided(reality.Machine(drag=0.002, power=power))
    assert [(f.effect, f.mechanism) for f in d.findings] == [(law, "fluid_friction")]


@pytest.mark.parametrize("foreign", [{"swirl": 0.008}, {"blend": 0.005}, {"sticky": 0.02}])
def test_a_small_unknown_function_of_the_state_gets_no_name_that_it_only_resembles(
    foreign: dict[str, float], decided: Decided
) -> None:
    d = decided(reality.Machine(**foreign))
    assert d.verdict in ("missing", "unexplained")
    assert all(f.effect == "unknown" for f in d.findings), d.findings
    if "sticky" in foreign:
        assert all(f.mechanism == "dry_friction" for f in d.findings), d.findings


def test_a_function_of_state_is_seen_where_no_law_resembles_it(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in (decision, nothing_named):
        monkeypatch.setattr(module, "sure", lambda *_: False)  # no law predicts any of it
    assert decided(reality.Machine(swirl=0.008)).verdict != "complete"


def test_joints_that_one_torque_over_their_positions_pulls_are_moved_at_the_same_time() -> None:
    model = model_of(VISCOUS, COULOMB)
    columns = reality.simulate(reality.Machine(), reality.multisine(4.0, RATE, 3), RATE)
    record = data_of(columns, model).records[0][0]
    search: Any = SimpleNamespace(
        final=SimpleNamespace(data=SimpleNamespace(records=[(record, record)]))
    )
    signals: Any = SimpleNamespace(
        position=np.zeros((10, 2)), command=np.ones((10, 2)), sample_time=1.0 / RATE
    )
    given: Any = SimpleNamespace(
        limits={}, joints=2, joint_kind=lambda j: "linear" if j == 2 else "rotary"
    )

    def proposed(*mechanisms: str) -> tuple[str, np.ndarray]:
        found: Any = [
            SimpleNamespace(effect="unknown", joint=k + 1, mechanism=m)
            for k, m in enumerate(mechanisms)
        ]
        said = proposal._without_rival([signals], given, [search, search], found, [], 0)
        assert said is not None and said.reference is not None
        return said.sentence, said.reference[0]

    said, q = proposed("position_torque", "position_torque")
    assert "record joints 1 and 2 again" in said and "at the same time" in said and " m)" in said
    assert np.ptp(q, axis=0).min() > 0.1 and abs(np.corrcoef(q.T)[0, 1]) < 0.9
    said, q = proposed("dry_friction", "position_torque")
    assert "record joint 1 again" in said and np.ptp(q[:, 1]) == 0


def _lacks(share: float, model: Model) -> Any:
    """The decision of a joint that lacks a share of its torque."""
    left = SimpleNamespace(value=share)
    return SimpleNamespace(joint=1, scale=0.1, after=left, final=SimpleNamespace(model=model))


@pytest.mark.parametrize(("share", "said"), [(0.01, True), (0.58, False)])
def test_the_time_of_a_command_is_asked_for_where_it_may_be_what_is_missing(
    share: float, said: bool
) -> None:
    """A pendulum behind its driven joint took 58 % of that one's torque, and its user was asked how
    long the loop holds a command; a command a row late makes 1 % of it.
    """
    model = model_of(VISCOUS, COULOMB)
    columns = reality.simulate(reality.Machine(), reality.multisine(4.0, RATE, 3), RATE)
    words = notes._held(_lacks(share, model), data_of(columns, model), model)
    assert ("[actuator] hold" in words) is said


def test_a_joint_that_nothing_drives_is_not_told_to_follow_a_reference() -> None:
    """A free pendulum was to follow a multisine, and its model to say how long a loop holds."""
    model = model_of(VISCOUS, COULOMB)
    columns = reality.simulate(reality.Machine(), reality.multisine(4.0, RATE, 3), RATE)
    fit = data_of(columns, model)
    free: Any = SimpleNamespace(records=[[replace(fit.records[0][0], command=0.0 * columns["u"])]])
    assert "[actuator] hold" in notes._held(_lacks(0.01, model), fit, model)
    assert notes._held(_lacks(0.01, model), free, model) == ""
    signals: Any = SimpleNamespace()
    search: Any = SimpleNamespace(final=SimpleNamespace(data=fit))
    found: Any = [SimpleNamespace(effect="unknown", joint=1, mechanism="dry_friction")]
    given: Any = SimpleNamespace(limits={}, joints=1, joint_kind=lambda _: "rotary")
    said = proposal._without_rival([signals], given, [search], found, [], 0, (1,))
    assert said is not None and said.reference is None
    assert said.sentence.startswith("Nothing drives joint 1: record it again from other")


@pytest.mark.parametrize(("effect", "says"), [
    ("unknown", "Nothing drives joint 2: record it again from other first positions"),
    ("coulomb", "To confirm coulomb at joint 2, which nothing drives, record it again from other"),
])  # fmt: skip
def test_the_pole_of_a_cart_is_not_told_to_follow_a_reference(effect: str, says: str) -> None:
    """The cart is driven, so a multisine of the pole was proposed, and its file written."""
    signals: Any = SimpleNamespace()
    run = [SimpleNamespace(command=np.ones(9)), SimpleNamespace(command=np.zeros(9))]
    asks: Any = Parts.undriven
    free = asks.fget(SimpleNamespace(all=SimpleNamespace(records=[run, run])))
    found: Any = [SimpleNamespace(effect=effect, joint=2, mechanism="dry_friction", confidence=0.4)]
    given: Any = SimpleNamespace(limits={}, joints=2)
    said = proposal._without_rival([signals], given, [], found, [], 0, free)
    assert said is not None and said.reference is None and said.sentence.startswith(says)
    asked: Any = SimpleNamespace(
        next_recording=said, given=given, undriven=free, stopped=False, doubted=()
    )
    assert no_reference(asked).startswith("joint 2 follows no reference, since nothing drives it:")
    found[0].indistinguishable = ("viscous",)
    search: Any = SimpleNamespace(steps=[])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(proposal, "_separable", lambda finding, _: finding)
        decisions: Any = [SimpleNamespace(joint=2, final=SimpleNamespace(model=given))]
        told = proposal.propose([signals], given, [search, search], found, decisions, 0, free)
    assert told is not None and told.reference is None
    assert f"To tell {effect} from viscous at joint 2, which nothing drives, rec" in told.sentence


def test_a_push_is_told_from_its_rivals_by_the_same_motion_again(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """The proposal ended in a colon."""
    found: Any = SimpleNamespace(
        effect="disturbance", joint=1, indistinguishable=("saturation",), mechanism="disturbance"
    )
    decision: Any = SimpleNamespace(joint=1, final=SimpleNamespace(model=None))
    monkeypatch.setattr(proposal, "_separable", lambda finding, _: finding)
    monkeypatch.setattr(proposal, "_rival", lambda *_: None)
    nothing: Any = None
    said = proposal.propose(nothing, nothing, [nothing], [found], [decision], 0)
    assert said is not None and said.reference is None
    assert said.sentence.startswith("To tell disturbance from saturation at joint 1: the same")
    assert "repeats, a push does not" in said.sentence


def test_a_mechanism_without_a_law_has_the_curve_of_its_torque_and_a_figure(
    decided: Decided,
) -> None:
    """swirl * sin(2 q̇): no law of the library."""
    d = decided(reality.Machine(swirl=0.02))
    (found,) = d.findings
    assert (found.effect, found.mechanism) == ("unknown", "fluid_friction")
    assert d.next_recording is not None and d.next_recording.reference is not None
    assert d.next_recording.sentence.startswith("Of the torque without a law, record joint 1 again")
    assert "depends on the speed of joint 1" in found.sentence
    curve = found.as_dict()["curve"]  # type: ignore[typeddict-item]
    assert (curve["variable"], curve["unit"]) == ("velocity", "rad/s")
    speed, torque = np.array(curve["at"]), np.array(curve["torque"])
    # calibration took up what resembles viscous and Coulomb friction
    true, given = 0.02 * np.sin(2 * speed), np.stack([speed, np.sign(speed)], 1)
    taken = given @ np.linalg.lstsq(given, true - torque, rcond=None)[0]
    assert np.corrcoef(torque, true - taken)[0, 1] > 0.9
    assert [c.name for c in charts(d) if c.section == "law"] == ["law_1_unknown_joint1"]
    for variable in ("position", "velocity"):  # whatever the recordings of the fit say
        said: Any = {"curve": {**found.numbers["curve"], "variable": variable}}
        chart = unknown_chart(d, d.workings, replace(found, numbers=said), 0)  # type: ignore[arg-type]
        assert chart is not None and chart.panels[0].xlabel.startswith(variable)


def test_viscous_friction_that_depends_on_the_position_is_not_called_dry_friction(
    decided: Decided
) -> None:
    """blend * q * q̇: its only law in the library is one of dry friction."""
    (found,) = decided(reality.Machine(blend=0.015)).findings
    assert (found.effect, found.mechanism) == ("unknown", "fluid_friction")
    assert "depends on the speed and position of joint 1" in found.sentence
    assert found.as_dict()["curve"]["against_motion"]  # type: ignore[typeddict-item]


def test_several_mechanisms_without_a_law_are_claimed_as_one_torque(
    decided: Decided, monkeypatch: pytest.MonkeyPatch
) -> None:
    def doubled(*arguments: Any) -> Decision:
        found = believed.believed(*arguments)
        other = [replace(c, mechanism="position_torque") for c in found.claims]
        return replace(found, claims=(*found.claims, *other))

    monkeypatch.setattr(decision, "believed", doubled)
    d = decided(reality.Machine(swirl=0.02))
    assert d.verdict != "complete" and len(d.findings) <= 1


@pytest.mark.parametrize(
    ("seed", "begins", "effect", "noted"),
    [(1, 0.0, "unknown", True), (1, 2.0, "unknown", True), (2, 0.0, "unknown", False),
     (1, 0.0, "coulomb", False), (1, 0.0, "", True)],
)  # fmt: skip
def test_a_torque_without_a_law_judged_on_the_same_motion_again_is_noted(
    seed: int, begins: float, effect: str, noted: bool
) -> None:
    """A hand that led a joint was a fluid friction (75 %); the held-out chirp was the same."""

    def record(name: str, seed: int, begins: float) -> Any:
        q = reality.multisine(10.0, 100.0, seed)[round(100 * begins) :]
        motion = SimpleNamespace(states=q[None])
        return SimpleNamespace(
            began=begins, sample_time=0.01, n=len(q), recording=name, motion=motion
        )

    fit, test = (SimpleNamespace(records=[[r]]) for r in (
        record("run1.csv", 1, 0.0), record("run2.csv", seed, begins)
    ))  # fmt: skip
    parts: Any = SimpleNamespace(fit=fit, test=test)
    kind = Verdict.MISSING if effect else Verdict.UNEXPLAINED
    decision: Any = SimpleNamespace(joint=1, kind=kind, claims=[SimpleNamespace(effect=effect)])
    told = notes.repeated([decision], parts)
    assert bool(told) is noted
    assert all("run2.csv repeats the motion of run1.csv" in note for note in told)
