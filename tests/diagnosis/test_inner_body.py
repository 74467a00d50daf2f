"""A wrong body inside a simulator, told from laws of its joints."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import pytest

from zendsp.diagnosis.decide.contract import Verdict
from zendsp.diagnosis.decide.result import FitTable, Left, Workings
from zendsp.diagnosis.external.inner_body import of_what_was_asked, without_parts
from zendsp.physics.model import Model, Quantity

H = 0.001  # s
TABLE = FitTable(3.0, 2.0, 1.0)


@dataclass(frozen=True)
class Said:
    """What of a diagnosis decides whether a body was taken for laws of joints."""

    findings: tuple[Any, ...]
    discrepancy: tuple[Left, ...]
    verdict: Verdict = Verdict.MISSING
    unexplained: str = ""
    improved: str = "improved"
    calibrated: str = "calibrated"
    estimation: FitTable = TABLE
    heldout: FitTable = TABLE
    test: FitTable | None = None
    next_recording: None = None
    workings: Any = None
    refinements: tuple[Any, ...] = ()


def said(*effects: str, left: float = 0.04) -> Any:
    findings = tuple(SimpleNamespace(effect=e, joint=j) for j, e in enumerate(effects, 1))
    rest = tuple(Left(j, left, (0.9 * left, 1.1 * left)) for j in (1, 2))
    return Said(findings, rest)


def arm(free: bool) -> Model:
    columns: dict[str, str | list[str]] = {"position": ["q1", "q2"]}
    mechanism = {"a1": (Quantity(1.0, free),), "b1": (Quantity(0.0, free),)}
    return Model("arm", H, "python", mechanism, columns=columns)


def test_a_body_inside_a_simulator_is_no_law_of_its_joints() -> None:
    """80 g at the tip of an FMU had become a torque gain of -36 %, an inertia and a coupling."""
    wrong, right = said("inertia", "torque_gain"), said("coulomb", left=1e-4)

    def alone(_model: Model) -> Any:
        raise AssertionError("not asked again")

    def freed(model: Model) -> Any:
        assert all(q.free for items in model.mechanism.values() for q in items)
        return said(left=1e-4)

    assert without_parts(right, arm(free=False), alone) is right
    gain = said("torque_gain", left=1e-4)
    assert without_parts(gain, arm(free=False), alone) is gain, "it leaves nothing: it is right"
    two = replace(gain, findings=(*gain.findings, SimpleNamespace(effect="inertia", joint=1)))
    assert without_parts(two, arm(free=False), freed).findings == (), "two laws of one joint"
    assert without_parts(two, arm(free=False), lambda _: two) is two
    gains = said("torque_gain", "torque_gain", left=1e-4)
    assert without_parts(gains, arm(free=False), freed).findings == (), "a gain of each joint"
    assert without_parts(gains, arm(free=False), lambda _: gains) is gains
    body = without_parts(wrong, arm(free=False), freed)
    assert body.verdict == "unexplained" and body.findings == ()
    assert "joints 1 and 2 is a wrong body" in body.unexplained and "a1" in body.unexplained
    beside = without_parts(wrong, arm(free=False), lambda _: right)
    assert beside.verdict == "missing" and beside.findings == right.findings
    for ask, model in ((alone, arm(free=True)), (lambda _: wrong, arm(free=False))):
        none = without_parts(wrong, model, ask)
        assert none.verdict == "unexplained" and none.findings == ()
        assert none.improved == "calibrated" and none.heldout.improved == 2.0


def test_laws_beside_parts_of_a_body_are_claimed_only_where_they_leave_nothing() -> None:
    """A payload of 0.5 kg on an FMU of two joints had been two gains, a Coulomb friction and a
    function without a law.
    """
    both = said("torque_gain", "coulomb")
    assert without_parts(both, arm(free=True), lambda _: both).findings == ()
    here, there = both.discrepancy
    right = replace(both, discrepancy=(here, replace(there, interval=(0.0, 1e-4))))
    assert without_parts(right, arm(free=True), lambda _: right) is right


def test_joints_that_lack_parts_of_a_body_are_said_to_though_no_law_is_named() -> None:
    """A payload on an FMU of two joints had been two sentences that named none of its causes."""
    none = replace(said(), verdict=Verdict.UNEXPLAINED, unexplained="Joint 1: a torque of 1 N m")

    def lacking(*effects: str | None) -> Any:
        decisions = [
            SimpleNamespace(joint=j, kind=Verdict.UNEXPLAINED, near=e and SimpleNamespace(effect=e))
            for j, e in enumerate(effects, 1)
        ]
        nothing: Any = None
        d = replace(none, workings=Workings(nothing, decisions, nothing, nothing, nothing))  # type: ignore[arg-type]
        return without_parts(d, arm(free=False), lambda _: d)

    body = lacking("torque_gain", None)
    assert body.verdict == "unexplained"
    assert "joints 1 and 2 (torque_gain) may be parts of a wrong body" in body.unexplained
    assert body.unexplained.endswith("Joint 1: a torque of 1 N m")
    for effects in (("stiffness", None), ("torque_gain",)):  # a hose; one joint alone
        assert lacking(*effects).unexplained == none.unexplained


@pytest.mark.parametrize(("law", "claimed"), [("inertia", False), ("viscous", True)])
def test_what_a_joint_feels_of_another_ones_motion_is_no_law_of_its_own(
    law: str, claimed: bool
) -> None:
    """A link's mass inside an FMU was a coupling (0.87), which left nothing."""
    coupling = SimpleNamespace(effect="coupling", joint=1, numbers={"law": law})
    friction = SimpleNamespace(effect="coulomb", joint=2, numbers={})

    def alone(_model: Model) -> Any:
        raise AssertionError("not asked again")

    for others in ((), (friction,)):
        found: Any = replace(said(left=1e-4), findings=(coupling, *others), refinements=())
        told = without_parts(found, arm(free=True), alone)
        assert told.findings == ((coupling, *others) if claimed else others)
        assert ("wrong body inside" in told.unexplained) is not claimed
        if not claimed and others:
            assert told.refinements == (coupling,), "the improved model has it"
        if not claimed and not others:
            assert told.verdict == Verdict.UNEXPLAINED and told.improved == "calibrated"


def test_what_ctrl_c_ended_claims_no_parts_of_a_body_that_was_not_asked_for() -> None:
    """3 kg at the tool of an FMU were a gain, a spring and two inertias at four joints."""
    laws = {
        "torque_gain": "actuator", "inertia": "inertia", "stiffness": "position_torque",
        "coulomb": "dry_friction",
    }
    gain, inertia, spring, friction = (
        SimpleNamespace(effect=e, joint=j, numbers={}, mechanism=m)
        for j, (e, m) in enumerate(laws.items(), 1)
    )
    parts: Any = replace(said(left=1e-4), findings=(gain, inertia, spring))
    told = of_what_was_asked(parts)
    assert told.verdict == Verdict.UNEXPLAINED and not told.findings
    assert "joints 1, 2 and 3 (torque_gain, inertia, stiffness) may be parts" in told.unexplained
    beside: Any = replace(parts, findings=(friction, gain, inertia, spring))
    told = of_what_was_asked(beside)
    assert told.findings == (friction,) and told.refinements == (gain, inertia, spring)
    alone: Any = replace(parts, findings=(gain,))
    assert of_what_was_asked(alone) is alone, "one law that leaves nothing is right"
