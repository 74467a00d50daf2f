"""The scorer counts known reports correctly."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from known import effect, found, truth

from zendsp.proof.answer import Answer, Estimate, Region, Smallest
from zendsp.proof.judge import judge
from zendsp.proof.page import proof_page
from zendsp.proof.scoreboard import (
    calibration_gap,
    failures,
    headline,
    missed_marks,
    text,
    upper_bound,
    worst_tenth,
)


def test_right_name_on_right_joint_is_named() -> None:
    j = judge(truth([effect("coulomb")]), Answer("missing", (found("coulomb"),)))
    assert j.named is True and j.strict is True and failures([j]) == []


def test_right_name_on_wrong_joint_is_not_named() -> None:
    j = judge(truth([effect("coulomb", joint=2)]), Answer("missing", (found("coulomb", joint=1),)))
    assert j.named is False and len(failures([j])) == 1


def test_set_that_holds_the_truth_counts_but_not_strictly() -> None:
    j = judge(
        truth([effect("coulomb")]),
        Answer("missing", (found("stribeck", indistinguishable=("coulomb",)),)),
    )
    assert j.named is True and j.strict is False and j.set_size == 2


def test_alias_by_algebra_and_by_the_oracle_count() -> None:
    t = truth([effect("lag", accepted=("inertia",))])
    assert judge(t, Answer("missing", (found("inertia"),))).named is True
    assert judge(t, Answer("missing", (found("delay"),))).named is True
    assert judge(t, Answer("missing", (found("ripple"),))).named is False


def test_right_name_second_is_not_named_first() -> None:
    j = judge(truth([effect("coulomb")]), Answer("missing", (found("ripple"), found("coulomb"))))
    assert j.named is False and j.extra == 1


def test_both_of_a_pair_must_lead() -> None:
    t = truth([effect("coulomb"), effect("ripple")], kind="pair")
    assert judge(t, Answer("missing", (found("ripple"), found("coulomb")))).both is True
    assert judge(t, Answer("missing", (found("ripple"),))).both is False
    assert (
        judge(t, Answer("missing", (found("ripple"), found("stiffness"), found("coulomb")))).both
        is False
    )


def test_one_finding_cannot_stand_for_two_effects() -> None:
    t = truth([effect("coulomb"), effect("ripple")], kind="pair")
    j = judge(t, Answer("missing", (found("ripple", indistinguishable=("coulomb",)),)))
    assert j.both is False


def test_replacement_needs_the_law_and_the_word() -> None:
    t = truth([effect("coulomb")], kind="replace")
    t["replaces"] = ["viscous"]
    assert judge(t, Answer("missing", (found("coulomb", replaces=("viscous",)),))).replaced is True
    assert judge(t, Answer("missing", (found("coulomb"),))).replaced is False


def test_false_alarms_are_claims_on_complete_machines() -> None:
    t = truth([], kind="complete", verdict="complete")
    assert judge(t, Answer("complete")).alarm is False
    assert judge(t, Answer("missing", (found("coulomb"),))).alarm is True
    assert judge(t, Answer("unexplained")).alarm is True


def test_a_mechanism_of_what_is_also_true_of_a_machine_is_no_false_alarm() -> None:
    t = truth([], kind="complete", verdict="complete", also_true=["saturation"])
    unlawful = Answer("missing", (found("unknown", mechanism="actuator"),))
    assert judge(t, unlawful).alarm is False and judge(t, unlawful).extra == 0
    assert judge(t, Answer("missing", (found("unknown", mechanism="dry_friction"),))).alarm is True
    assert judge(truth([], kind="complete", verdict="complete"), unlawful).alarm is True


def test_a_disturbance_named_beside_a_nuisance_is_charged_and_unexplained_is_true_of_a_large_one() -> (  # noqa: E501
    None
):
    named = Answer("missing", (found("disturbance"),))
    large = truth([], kind="nuisance", verdict="complete", also_true=["unexplained"])
    for t in (truth([], kind="nuisance", verdict="complete"), large, truth([], verdict="complete")):
        j = judge(t, named)
        assert j.alarm is True and j.extra == 1 and j.sure_wrong
    assert judge(large, Answer("unexplained")).alarm is False
    assert (
        judge(truth([], kind="nuisance", verdict="complete"), Answer("unexplained")).alarm is True
    )
    beside = judge(
        truth([effect("coulomb")], kind="hard"),
        Answer("missing", (found("coulomb"), found("disturbance"))),
    )
    assert beside.named is True and beside.extra == 1


def test_mechanism_is_judged_before_the_law() -> None:
    t = truth([effect("coulomb")])
    j = judge(t, Answer("missing", (found("hysteresis"),)))
    assert j.mechanism is True and j.law is False and j.extra == 0 and j.sure_wrong
    unknown = judge(t, Answer("missing", (found("unknown", mechanism="dry_friction"),)))
    assert unknown.mechanism is True and unknown.law is False and not unknown.sure_wrong
    elsewhere = judge(t, Answer("missing", (found("hysteresis", joint=2),)))
    assert elsewhere.mechanism is False and elsewhere.extra == 1
    other = judge(t, Answer("missing", (found("viscous"),)))
    assert other.mechanism is False and other.extra == 1


def test_position_friction_is_no_name_for_plain_coulomb() -> None:
    t = truth(
        [
            {
                **effect("coulomb"),
                "oracle": {"detectable": True, "inseparable": {"position_friction": 1.0}},
            }
        ]
    )
    j = judge(t, Answer("missing", (found("position_friction"),)))
    assert j.law is False and j.mechanism is True
    assert judge(t, Answer("missing", (found("coulomb"),))).law is True


def test_second_finding_of_a_mechanism_that_acts_once_is_beyond_the_truth() -> None:
    t = truth([effect("coulomb")])
    j = judge(t, Answer("missing", (found("coulomb"), found("hysteresis"))))
    assert j.named is True and j.extra == 1
    j = judge(t, Answer("missing", (found("hysteresis"), found("presliding"))))
    assert j.extra == 1


def test_smaller_of_two_effects_of_one_mechanism_may_stand_among_the_refinements() -> None:
    t = truth([effect("stribeck"), effect("friction_drift")], kind="pair")
    refined = Answer("missing", (found("stribeck"),), refinements=(found("friction_drift"),))
    assert judge(t, refined).both is True
    assert judge(t, Answer("missing", (found("stribeck"),))).both is False
    # another mechanism is a finding of its own
    other = truth([effect("stribeck"), effect("ripple")], kind="pair")
    assert (
        judge(other, Answer("missing", (found("stribeck"),), refinements=(found("ripple"),))).both
        is False
    )


def test_body_is_right_by_its_name_whatever_the_joint() -> None:
    payload = {**effect("payload", accepted=("body",)), "body": "link6", "mechanisms": []}
    t = truth([payload])
    assert judge(t, Answer("missing", (found("payload", joint=6, body="link6"),))).law is True
    assert judge(t, Answer("missing", (found("body", joint=6, body="link6"),))).law is True
    assert (
        judge(t, Answer("missing", (found("payload", joint=6, body="link3"),))).mechanism is False
    )


def test_called_complete_above_the_stated_size_is_counted() -> None:
    t = truth([effect("coulomb", level=0.05)])
    assert judge(t, Answer("complete", smallest=(Smallest(1, "coulomb", 0.01),))).missed is True
    assert judge(t, Answer("complete", smallest=(Smallest(1, "coulomb", 0.10),))).missed is False
    assert judge(t, Answer("complete", smallest=(Smallest(1, "ripple", 0.01),))).missed is None
    named = Answer("missing", (found("coulomb"),), smallest=(Smallest(1, "coulomb", 0.01),))
    assert judge(t, named).missed is False


def test_findings_that_make_an_untouched_recording_worse_are_counted() -> None:
    t = truth([effect("coulomb")])
    assert judge(t, Answer("missing", (found("coulomb"),), untouched=(1.0, 1.5))).worse is True
    assert judge(t, Answer("missing", (found("coulomb"),), untouched=(1.0, 0.5))).worse is False
    assert judge(t, Answer("missing", (found("coulomb"),))).worse is None
    assert judge(t, Answer("unexplained", untouched=(1.0, 1.0))).worse is None


def test_foreign_torque_may_be_claimed_by_its_mechanism_without_a_law() -> None:
    t = truth(
        [{**effect("foreign"), "mechanisms": ["dry_friction"]}],
        kind="foreign",
        verdict="unexplained",
    )
    j = judge(t, Answer("missing", (found("unknown", mechanism="dry_friction"),)))
    assert j.refused is True and j.extra == 0 and j.confidences == ((0.95, True),)
    assert (
        judge(t, Answer("missing", (found("unknown", mechanism="fluid_friction"),))).refused
        is False
    )
    assert (
        judge(t, Answer("missing", (found("unknown", joint=2, mechanism="dry_friction"),))).refused
        is False
    )
    law = judge(t, Answer("missing", (found("position_friction"),)))
    assert law.refused is False and law.extra == 1 and law.sure_wrong
    assert judge(t, Answer("complete")).refused is False
    faint = {**effect("foreign"), "oracle": {"detectable": True, "torque_share": 0.004}}
    assert (
        judge(truth([faint], kind="foreign", verdict="unexplained"), Answer("complete")).refused
        is None
    )


def test_foreign_torque_of_time_may_be_called_a_disturbance() -> None:
    t = truth(
        [{**effect("foreign"), "mechanisms": ["disturbance"]}],
        kind="foreign",
        verdict="unexplained",
    )
    assert judge(t, Answer("missing", (found("disturbance"),))).refused is True


def test_foreign_torque_must_be_refused_without_physics() -> None:
    t = truth([effect("foreign")], kind="foreign", verdict="unexplained")
    assert judge(t, Answer("unexplained")).refused is True
    assert judge(t, Answer("unexplained", (found("ripple"),))).refused is False
    assert judge(t, Answer("missing", (found("ripple"),))).refused is False


def test_parameter_errors_and_coverage() -> None:
    t = truth([effect("coulomb", level=0.05, angle=3.1)])
    values = {"level": Estimate(0.052, 0.001), "angle": Estimate(-3.1, 0.1)}
    j = judge(t, Answer("missing", (found("coulomb", parameters=values),)))
    assert j.errors == {"coulomb.level": pytest.approx(0.04)}
    # 3.1 and -3.1 rad are 0.08 apart
    assert j.covered == {"coulomb.level": False, "coulomb.angle": True}


def test_gap_closed_is_between_calibrated_and_noise() -> None:
    t = truth([effect("coulomb")])
    j = judge(
        t, Answer("missing", (found("coulomb"),), calibrated=1.1, improved=0.2, noise_floor=0.1)
    )
    assert j.gap == pytest.approx(0.9)


def test_place_is_found_by_a_region_that_holds_it() -> None:
    t = truth([effect("stribeck")], where=[{"variable": "velocity", "joint": 1, "value": 0.0}])
    assert (
        judge(
            t,
            Answer("missing", (found("stribeck"),), regions=(Region(1, "velocity", (-0.1, 0.1)),)),
        ).localised
        is True
    )
    assert (
        judge(
            t, Answer("missing", (found("stribeck"),), regions=(Region(1, "velocity", (0.5, 1.0)),))
        ).localised
        is False
    )


def test_bound_is_clopper_pearson() -> None:
    assert upper_bound(0, 149) == pytest.approx(1 - 0.05 ** (1 / 149))  # rule of three, exactly
    assert upper_bound(0, 0) == 1.0 and upper_bound(5, 5) == 1.0


def test_overconfidence_shows_in_the_calibration() -> None:
    right = judge(truth([effect("coulomb")]), Answer("missing", (found("coulomb"),)))
    wrong = judge(truth([effect("coulomb")]), Answer("missing", (found("ripple"),)))
    assert calibration_gap([right] * 19 + [wrong]) == pytest.approx(0.0, abs=1e-9)
    assert calibration_gap([right, wrong]) == pytest.approx(0.45)


def test_scoreboard_prints_every_promise() -> None:
    judged = [
        judge(
            truth([effect("coulomb", level=0.05)]),
            Answer("missing", (found("coulomb"),), seconds=2.0),
        )
    ]
    printed = text(judged, "known")
    assert all(row[0].strip() in printed for row in headline(judged))
    assert "1/1 = 100.0%" in printed


def test_names_of_cases_given_in_two_forms_are_compared() -> None:
    right = Answer("missing", (found("coulomb"),))
    judged = [
        judge(truth([effect("coulomb")], reality="mujoco", seed=k, given=given), answer)
        for k, given, answer in (
            (1, "", right),
            (1, "mjcf", right),
            (2, "", right),
            (2, "mjcf", Answer("missing", (found("ripple"),))),
            (3, "", right),  # has no twin
        )
    ]
    printed = text(judged, "forms")
    assert "given as urdf" in printed and "2/2 = 100.0%" in printed.split("given as urdf")[1]
    assert "1/2 = 50.0%" in printed.split("given as mjcf")[1].splitlines()[0]
    assert "the same first name in both" in printed
    page = proof_page(judged, {}, command="zendsp prove", stamp="")
    assert "## Given as URDF and as MJCF" in page
    assert "given as" not in text([judged[0]], "one form").lower()


def test_each_reality_has_a_column_and_a_table_of_confidence() -> None:
    own = judge(truth([effect("coulomb")]), Answer("missing", (found("coulomb"),)))
    other = judge(
        truth([effect("coulomb")], reality="mujoco"), Answer("missing", (found("ripple"),))
    )
    printed = text([own, other], "both")
    row = next(line for line in printed.splitlines() if "mechanism first" in line)
    assert "1/1 = 100.0%" in row and "0/1 = 0.0%" in row
    assert printed.count("stated confidence ") == 3  # two tables, and the row of the scoreboard
    page = proof_page([own, other], {}, command="zendsp prove", stamp="")
    assert "| zendsp, mujoco | zendsp, own |" in page and "stated (zendsp, mujoco)" in page


def test_marks_are_missed_by_a_diagnosis_that_always_says_yes() -> None:
    foreign = truth([effect("foreign")], kind="foreign", verdict="unexplained")
    silent = truth([], kind="complete", verdict="complete")
    named = truth([effect("coulomb")])
    yes = Answer("missing", (found("coulomb"), found("ripple")))
    assert missed_marks([judge(t, yes) for t in (foreign, silent, named)]) == [
        "false alarms: 1/1 = 100.0%, at most 15%",
        "foreign torque without a law claimed: 0/1 = 0.0%, at least 25%",
        "cases with a wrong name stated as sure: 3/3 = 100.0%, at most 20%",
        "names beyond the truth, per case: 1.67, at most 0.5",
    ]
    right = [judge(foreign, Answer("unexplained")), judge(silent, Answer("complete"))]
    assert missed_marks([*right, judge(named, Answer("missing", (found("coulomb"),)))]) == []


def test_worst_tenth_needs_enough_findings() -> None:
    right = judge(truth([effect("coulomb")]), Answer("missing", (found("coulomb"),)))
    wrong = judge(truth([effect("coulomb")]), Answer("missing", (found("ripple"),)))
    assert worst_tenth([right] * 15 + [wrong] * 5) == pytest.approx(0.20)
    assert math.isnan(worst_tenth([right] * 10 + [wrong] * 5))


def test_cases_with_a_wrong_name_stated_as_sure_are_counted_once() -> None:
    t = truth([effect("coulomb")])
    j = judge(t, Answer("missing", (found("ripple"), found("stiffness"), found("coulomb"))))
    assert j.sure_wrong and j.extra == 2
    unsure = replace(found("ripple"), confidence=0.6)
    assert not judge(t, Answer("missing", (found("coulomb"), unsure))).sure_wrong
