"""A force between links, as of a hose or a strap, is no body, and one finding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from small_arms import Arm, prepared, recorded, searched
from test_across import lacking, named

from zendsp.diagnosis.decide.across import across_joints, may_be_strapped
from zendsp.diagnosis.decide.propose import propose
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.measure.structure import Structure
from zendsp.diagnosis.search.body_columns import Layout
from zendsp.diagnosis.search.body_hypotheses import LIMITS
from zendsp.diagnosis.search.straps import Strap, strap_in_place_of

STRAP = Arm(strap=50.0)


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Any]:
    """``recorded`` in one folder, for 15 s, with the friction known."""
    folder = tmp_path_factory.mktemp("arms")
    return partial(recorded, folder, friction=True, seconds=15.0)


def test_a_strap_over_two_joints_is_proposed_as_no_body(record: Callable[..., Any]) -> None:
    found = searched(record("strap", STRAP))
    assert not found.found and not found.instead and not found.small
    assert found.strap is not None and 2 in found.strap.joints and found.strap.z > 4.0
    # without the strap: a tilted base of 10 degrees. That a body is no strap: test_joint_zeros.py


def test_a_strap_is_one_finding_at_the_joint_where_it_pulls_most() -> None:
    pulled = [lacking(1, "stiffness", coefficient=2.0), lacking(2, "gravity", sine=1.0)]
    pulled = [replace(d, scale=s) for d, s in zip(pulled, (1.0, 2.0), strict=True)]
    other = lacking(3, "coulomb", level=1.0)
    found = across_joints([*pulled, other], Strap((1, 2), 8.0))
    assert named(found)[:2] == [[], [("unknown", "position_torque", ())]]
    assert found[0].kind == "unexplained" and found[0].strap == (1, 2)
    # the law that stays in the improved model refines it
    assert [c.effect for c in found[0].refinements] == ["stiffness"]
    assert found[2] == other


def test_a_strap_that_no_joint_claims_is_claimed_where_most_is_missing() -> None:
    nobody = [
        replace(lacking(j, "coulomb", level=1.0), kind="unexplained", claims=()) for j in (1, 2)
    ]
    sizes = Structure(0.02, 0.9, 5.0), Structure(0.1, 0.9, 5.0)
    nobody = [replace(d, state=state) for d, state in zip(nobody, sizes, strict=True)]
    assert named(across_joints(nobody, Strap((1, 2), 8.0))) == [
        [],
        [("unknown", "position_torque", ())],
    ]
    assert across_joints([replace(d, kind="complete") for d in nobody], Strap((1, 2), 8.0))[
        1
    ].claims == ()


def test_a_strap_that_joints_took_for_laws_of_their_own_has_one_potential(
    record: Callable[..., Any],
) -> None:
    for arm, several in ((STRAP, True), (Arm(gain=1.1), False)):
        model, paths = record(f"alone {arm.strap}", arm)
        data = prepared((model, paths))
        layout = Layout(model, data[0].records[0][0].links)
        assert (strap_in_place_of([], data, layout, LIMITS, 1, alone=True) is not None) == several


def test_a_strap_is_looked_for_where_two_joints_lack_something_over_their_positions() -> None:
    pulled, other = lacking(1, "stiffness", coefficient=2.0), lacking(2, "coulomb", level=1.0)
    assert may_be_strapped([pulled, other])
    assert not may_be_strapped([pulled, replace(other, kind="complete", claims=())])
    assert not may_be_strapped([lacking(1, "coulomb", level=1.0), other])


def test_what_pulls_by_times_at_two_joints_is_no_push() -> None:
    nobody = [
        replace(lacking(j, "coulomb", level=1.0), kind="unexplained", claims=()) for j in (1, 2)
    ]
    state = Structure(0.1, 0.9, 5.0)
    pushed = replace(nobody[0], kind="disturbance", state=state, before=Size(0.2, 0.1, 0.3))
    assert may_be_strapped([pushed, nobody[1]])
    beside = replace(pushed, joint=3)  # where the strap ends, perhaps
    *found, last = across_joints([pushed, nobody[1], beside], Strap((1, 2), 8.0))
    assert last.kind == "unexplained" and not last.strap
    assert named(found) == [[("unknown", "position_torque", ())], []]


def test_what_pulls_between_links_is_to_be_taken_off_next() -> None:
    pulled = [lacking(j, "stiffness", coefficient=2.0) for j in (1, 2)]
    decisions = across_joints(pulled, Strap((1, 2), 8.0))
    said = propose([None], None, [], [], decisions, 0)  # type: ignore[list-item,arg-type]
    assert said is not None and said.reference is None
    assert "between the links at joints 1 and 2 (a hose" in said.sentence
