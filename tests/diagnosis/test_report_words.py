"""The words of a report: what it says, and what it does not."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import reality

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.decide import findings, notes, nothing_named
from zendsp.diagnosis.decide.contract import (
    Reason,
    Rejected,
    Verdict,
    contradicted,
    dark,
    nearest,
)
from zendsp.diagnosis.decide.findings import Estimate, Finding, number
from zendsp.diagnosis.decide.headline import percent, verdict_sentence, word_of
from zendsp.diagnosis.decide.naming import lifted
from zendsp.diagnosis.decide.result import Detectable, Workings
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.measure.structure import Structure
from zendsp.diagnosis.report import figures, files, html
from zendsp.diagnosis.report.summary import _refinement, _sized, summary, unnamed
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Quantity, Term


def _proposing(proposal: object, *rejected: Rejected) -> Diagnosis:
    return SimpleNamespace(  # type: ignore[return-value]
        next_recording=proposal, verdict="complete", rejected=rejected, regions=(), times=(),
        stopped=False, doubted=contradicted(rejected), nameless=(),
    )


def test_the_report_does_not_say_nothing_is_open_where_a_torque_has_no_name() -> None:
    left = SimpleNamespace(**(vars(_proposing(None)) | {"nameless": ((1, 0.003),)}))
    why = files.no_reference(left)  # type: ignore[arg-type]
    assert why == "what is left has no name, and no rival to be told from"


def test_the_report_does_not_say_settled_where_the_headline_cannot_tell() -> None:
    doubtful = _proposing(None, Rejected("backlash", 1, "the untouched do not show it", 1e4))
    assert files.no_reference(doubtful) == "no motion can be proposed for what is open"
    assert "Nothing is missing" not in html._where(doubtful)
    assert "no place is named" in html._where(doubtful)
    assert "Nothing is missing" in html._where(_proposing(None))


def test_the_unit_of_a_pure_number_is_not_read_out() -> None:
    assert _sized(Detectable(1, "actuator", "torque_gain", 0.0025, "1", 0.1)) == "0.0025"
    assert _sized(Detectable(1, "dry_friction", "coulomb", 0.25, "N m", 0.1)) == "0.25 N m"


def test_a_refinement_beneath_a_finding_is_not_said_to_be_for_the_fit_alone() -> None:
    """Coulomb friction, to which a Stribeck curve falls, stood there as the others. What has no law
    stands on nothing: it ended the summary as an effect that is not known.
    """
    falls, dry, wave, push, nameless = (
        Finding(name, 1, {}, 0.9, 1.0, (), (), "")
        for name in ("stribeck", "coulomb", "ripple", "disturbance", "unknown")
    )
    d: Any = SimpleNamespace(findings=(push, nameless, falls), refinements=(dry, wave))
    assert _refinement(dry, d) == "coulomb (joint 1, beneath stribeck)"
    assert _refinement(wave, d) == "ripple (joint 1)"


@pytest.mark.parametrize(("every", "said"), [(1, "over 0.25 s ["), (10, "over 0.64 s [")])
def test_a_report_says_how_long_the_simulations_were_whose_errors_it_states(
    every: int, said: str, tmp_path: Path
) -> None:
    """At 25 Hz a window has 16 rows, not 0.25 s."""
    columns = reality.simulate(reality.Machine(), reality.multisine(20.0, 250.0, 3), 250.0)
    kept = {k: v[::every] for k, v in columns.items()}
    terms = [reality.effect("viscous", coefficient=0.004), reality.effect("coulomb", level=0.03)]
    model = reality.model_file(tmp_path / "model.toml", 250.0 / every, *terms)
    d = diagnose(reality.save(tmp_path / "run.csv", kept), model)
    assert said in summary(d) and said.replace("over", "within") in html._fit_of(d.errors[0])
    assert isinstance(d.workings, Workings)
    panel = figures.error_chart(d, d.workings, 1).panels[0]
    assert said.removesuffix(" [") in panel.title


@pytest.mark.parametrize(
    ("share", "text"), [(0.0351, "3.5 %"), (0.996, "100 %"), (1.0, "100 %"), (4.217, "422 %")]
)
def test_a_share_of_a_torque_is_never_printed_as_a_power_of_ten(share: float, text: str) -> None:
    assert percent(share) == text


def test_an_unknown_remainder_is_never_called_small() -> None:
    assert unnamed(0.0, 1.0) == "at most 100 % of its torque, and perhaps nothing"
    assert unnamed(0.0, 0.2) == "at most 20 % of its torque, and perhaps nothing"
    assert unnamed(1.0, 1.0) == "100 % of its torque"


def test_dry_friction_between_joints_is_not_called_a_mass() -> None:
    coupling, inertia = (word_of("inertia", (law,)) for law in ("coupling", "inertia"))
    text = verdict_sentence("missing", [(coupling, ("coupling",), 1, 0.9)])
    assert text == "Missing physics: the other joints' motion (coupling) at joint 1."
    assert "mass" in verdict_sentence("missing", [(inertia, ("inertia",), 1, 0.9)])


def test_the_headline_tells_what_is_doubtful_from_what_is_probable() -> None:
    dry, fluid = "dry friction", "fluid friction"
    found = [(dry, ("coulomb",), 1, 0.97), (fluid, ("unknown",), 2, 0.93)]
    assert verdict_sentence("missing", [*found, (dry, ("coulomb",), 2, 0.42)]) == (
        "Missing physics: dry friction (coulomb) at joint 1; fluid friction (unknown) at joint 2."
        " Doubtful: dry friction (coulomb, 42 %) at joint 2."
    )
    assert verdict_sentence("missing", [("a disturbance", ("disturbance",), 1, 0.5)]) == (
        "Perhaps missing physics: a disturbance (50 %) at joint 1."
    )


def test_recordings_that_show_nothing_are_not_called_a_complete_model() -> None:
    assert dark([(1, (0.0, 0.2)), (2, (0.0, 1.0))]) == (2,)
    assert verdict_sentence("complete", [], ()).startswith("Complete: ")
    assert verdict_sentence("complete", [], (1, 2)) == (
        "Cannot tell: nothing is seen to be missing, but the recordings to judge on leave open"
        " up to all of the torque of"
        " joints 1 and 2."
    )


def test_what_only_the_recordings_of_the_fit_say_is_not_called_complete() -> None:
    tried = [
        Rejected("backlash", 1, "on the recordings held out", 5925.0),
        Rejected("ripple", 1, "0.02 % of the torque", 900.0, Reason.TOO_SMALL),
        Rejected("ripple", 2, "0.02 % of the torque", 9000.0, Reason.TOO_SMALL),
        Rejected("delay", 3, "a simulator of other steps seems as late", 1871.0),
        Rejected("delay", 4, "does not explain the mismatch", 0.0),
    ]
    mass = Rejected("voltage_limit", 5, "on the recordings held out", 1196.0)
    assert contradicted([*tried, mass]) == (("backlash", 1), ("voltage_limit", 5))
    # a transmission's error, which held-out motion showed too little of, was called one of the
    # sensor, with less of the log-likelihood
    likelier = Rejected("transmission_error", 1, "0.023 %", 7000.0, Reason.TOO_SMALL)
    assert contradicted([*tried, likelier]) == (("transmission_error", 1),)
    assert (doubted := contradicted(tried)) == (("backlash", 1),)
    assert verdict_sentence("unexplained", [], doubted=doubted) == (
        "Cannot tell: the recordings of the fit are by far likelier with backlash at joint 1, and"
        " the untouched ones show too little of it. Hold out motion like theirs."
    )


@pytest.mark.parametrize(("share", "text"), [(0.9949, "99"), (0.995, "100"), (0.9999, "100")])
def test_nearly_all_of_a_torque_is_100_per_cent_and_not_a_power_of_ten(
    share: float, text: str
) -> None:
    assert findings.percent(share) == text


def test_the_page_does_not_say_nowhere_above_a_picture_with_shaded_spans() -> None:
    some = SimpleNamespace(
        verdict="missing", regions=(), times=((3.7, 4.2),), times_of=("a",), missing={}
    )
    text = html._where(some)  # type: ignore[arg-type]
    assert "3.70–4.20 s" in text and "Nowhere" not in text
    assert "No interval of a joint's own velocity" in text, "the map may be over another joint's"
    none = SimpleNamespace(
        verdict="missing", regions=(), times=(), times_of=(), missing={}, doubted=()
    )
    for pictured in (True, False):
        said = html._where(none, pictured=pictured)  # type: ignore[arg-type]
        assert "No interval" in said and "Nowhere" not in said
        assert ("a picture shows more, too few passes" in said) == pictured
    none.verdict = "complete"
    assert "Nothing is missing" in html._where(none)  # type: ignore[arg-type]


def test_no_rejected_rival_with_a_positive_likelihood_is_called_no_more_likely() -> None:
    left, search = Size(0.1, 0.1, 0.1), SimpleNamespace(joint=1)
    lost_of = partial(nothing_named._lost, "stiffness", search, pieces=(), before=left, beside=left)
    for gain, words in ((-10.0, "no more likely"), (14.0, "hardly more likely"), (
        80.0, "is not what is missing")):  # fmt: skip
        lost = lost_of(gain=gain)
        assert words in lost.why and (lost.score > 0.0) != ("no more" in lost.why)
    lost = lost_of(gain=14.0)
    assert "log-likelihood +7, and +20" in lost.why


def test_the_headline_names_the_law_that_an_unexplained_torque_is_most_like() -> None:
    tried = [
        Rejected("delay", 1, "on the recordings held out", 9e4),
        Rejected("hysteresis", 1, "0.46 % of the torque", 3e4, Reason.NEAR),
        Rejected("ripple", 1, "0.1 % of the torque", 2e4, Reason.NEAR),
    ]
    assert nearest("unexplained", tried) == (("hysteresis", 1),)
    assert not nearest("complete", tried) and not nearest("unexplained", tried[:1])
    said = verdict_sentence("unexplained", [], near=nearest("unexplained", tried))
    assert said == (
        "Unexplained: something is missing that is most like hysteresis at joint 1, and not surely"
        " that; no physics is claimed."
    )
    assert "no known effect surely describes" in verdict_sentence("unexplained", [])


def test_each_joint_that_stays_unexplained_has_a_line_whatever_its_words() -> None:
    left: Any = SimpleNamespace(findings=(), unexplained="one. Joint 2: of one\nthe other")
    assert html._sentences(left) == "<ul><li>one. Joint 2: of one<li>the other</ul>"


def test_a_number_that_rounds_to_nothing_has_no_sign() -> None:
    assert number(Estimate(-0.001, 0.1, "rad")) == "0.00 ± 0.10 rad"
    assert number(Estimate(-0.0, 0.0, "rad")) == "0 rad"


@pytest.mark.parametrize("name", ["model.toml", "calibrated.toml", "compensation.c"])
def test_a_report_writes_through_no_link_into_a_file_elsewhere(tmp_path: Path, name: str) -> None:
    precious = tmp_path / "precious.txt"
    precious.write_text("precious")
    out = tmp_path / "out"
    out.mkdir()
    (out / name).symlink_to(precious)
    files._clear(out)
    (out / name).write_text("of the report")
    assert precious.read_text() == "precious"


@pytest.mark.parametrize(
    ("mechanism", "confidence", "word"),
    [
        ("dry_friction", 0.6, "friction, dry or fluid"),
        ("dry_friction", 0.93, "dry friction"),
        ("fluid_friction", 0.5, "fluid friction"),
    ],
)
def test_a_friction_that_is_not_surely_dry_is_not_called_so(
    mechanism: str, confidence: float, word: str
) -> None:
    """|v|^0.6 and a brake by eddy currents were "dry friction (unknown)", 93 %."""
    found = Finding("unknown", 1, {}, confidence, 1.0, (), (), "", mechanism=mechanism)
    assert found.word == word


@pytest.mark.parametrize(
    ("state", "said"),
    [
        (Structure(0.05, 0.8, 6.0, 9.0), "2.5 N m RMS (5 % of the torque) depends on the state of"),
        (Structure(0.05, 0.35, 2.7, 5.4), "of which functions of the joint's state predict 35 %"),
        (Structure(0.05, 0.31, 2.0, 4.4), "nor any smooth function of the joint's state predicts"),
    ],
)
def test_a_torque_over_time_alone_is_not_said_to_depend_on_the_state(
    state: Structure, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two slow torques that no state made did, "5 %" and "22 % of the torque"."""
    for also in ("_behind_another", "_hardly_moves", "_held"):
        monkeypatch.setattr(notes, also, lambda *_: "")
    left: Any = SimpleNamespace(
        joint=1, kind=Verdict.UNEXPLAINED, searched=True, doubted=(), strap=(), near=None, loads=(),
        scale=50.0, state=state, after=Size(0.08, 0.07, 0.1),
    )  # fmt: skip
    given: Any = SimpleNamespace(torque_unit=lambda _: "N m")
    words = notes._left_at(left, (left,), given, given)
    assert said in words
    assert ("depends on the state" in words) is (state.share > 0.5)
    slides: Any = SimpleNamespace(torque_unit=lambda _: "N")
    assert "a force of " in notes._left_at(left, (left,), slides, slides)


def test_what_depends_on_the_state_is_no_larger_than_what_is_missing() -> None:
    """ "0.33 N m RMS (297 % of the torque)" stood above a figure that ended at 0.2 N m."""
    left: Any = SimpleNamespace(
        joint=1, scale=0.11, state=Structure(2.97, 0.8, 6.0, 9.0), after=Size(0.72, 0.7, 0.8)
    )
    given: Any = SimpleNamespace(torque_unit=lambda _: "N m")
    assert notes._of_state(left, given).startswith("a torque of 0.079 N m RMS (72 % of the torque)")


@pytest.mark.parametrize(("kind", "said"), [
    ("linear", " Where the joint slides up and down, 1.5000 ± 0.0030 kg more to lift than the model"
               " says, or less, is the same force."),
    ("rotary", ""),
])  # fmt: skip
def test_a_constant_force_may_be_the_weight_of_what_a_sliding_joint_lifts(
    kind: str, said: str
) -> None:
    """A load of 1.5 kg on the quill of a SCARA was a constant force of its drive and no more."""
    mass = {"mass" if kind == "linear" else "inertia": 1.0}
    given = parse_model({"name": "z", "mechanism": {"kind": kind, "parameters": mass}}, "z.toml")
    term = Term("torque_offset", 1, {"level": Quantity(14.715)})
    assert lifted(given, term, {"level": Estimate(14.715, 0.029, "N")}) == said
