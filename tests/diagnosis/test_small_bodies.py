"""The smallest bodies that recordings of an arm would have shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_arms import Arm, prepared, recorded, searched

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.detectable_bodies import detectable_bodies
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.explain import machine
from zendsp.diagnosis.report import summary
from zendsp.diagnosis.search import bodies, body_numbers
from zendsp.diagnosis.search.body_columns import NUISANCE, _frictions
from zendsp.diagnosis.search.body_hypotheses import LIMITS, Hypothesis
from zendsp.diagnosis.search.body_solver import Solver
from zendsp.physics.model import Model
from zendsp.physics.term_numbers import kernel_model

LEFT = 0.002  # of the RMS torque of each joint: stays unexplained


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., tuple[Model, list[Path]]]:
    """``recorded`` in one folder."""
    return partial(recorded, tmp_path_factory.mktemp("arms"))


def least(made: tuple[Model, list[Path]], left: float = LEFT, claims: Any = ()) -> Any:
    """Sizes by effect and joint."""
    fit, choose = prepared(made)
    decisions: Any = [SimpleNamespace(after=SimpleNamespace(value=left, often=0.0))] * 3
    found = detectable_bodies(
        Parts(fit, choose, choose), kernel_model(made[0]), decisions, claims, 1
    )
    return {(x.effect, x.joint): x for x in found}


@pytest.fixture(scope="module")
def sizes(record) -> Any:  # type: ignore[no-untyped-def]
    """Of an arm from which nothing but friction is missing; tests only read them."""
    return least(record("none", Arm()))


def test_a_payload_of_the_size_that_is_stated_is_found_and_a_tenth_of_it_is_not(  # type: ignore[no-untyped-def]
    record, sizes: Any
) -> None:
    stated = sizes["payload", 3]
    assert stated.mechanism == "inertia" and stated.unit == "kg" and 0.01 <= stated.share < 0.3
    for part, name in ((1.0, "as_large"), (0.1, "a_tenth")):
        made = record(name, Arm(mass=part * stated.size, com=(0.3, 0.1, 0.0)))
        assert bool(searched(made).found) == (part == 1.0)


def test_a_tilt_and_links_masses_are_stated_where_some_joint_feels_them(  # type: ignore[no-untyped-def]
    record, sizes: Any
) -> None:
    assert {key for key in sizes if key[0] == "base_tilt"} == {("base_tilt", 1)}
    assert sizes["base_tilt", 1].unit == "rad" and sizes["base_tilt", 1].size < 0.1
    # the first link turns about the vertical on the axis, and its mass is felt by nothing
    assert ("body", 1) not in sizes and ("body", 2) in sizes
    tilted = record("tilted", Arm(tilt=sizes["base_tilt", 1].size))
    assert [f.term.effect for f in searched(tilted).found] == ["base_tilt"]


def test_only_what_is_larger_than_the_unexplained_torque_would_be_found(record, sizes: Any) -> None:  # type: ignore[no-untyped-def]
    much = least(record("none", Arm()), 20 * LEFT)
    assert much["payload", 3].size > 1.5 * sizes["payload", 3].size


def test_no_body_is_stated_that_alone_would_be_all_the_torque(record) -> None:  # type: ignore[no-untyped-def]
    # a motion of 3 s of the shipped planar arm had a payload of 1 200 000 kg
    assert not least(record("none", Arm()), 1.0)


def test_a_body_that_was_found_is_not_told_as_missed(record) -> None:  # type: ignore[no-untyped-def]
    term = SimpleNamespace(effect="payload", joint=3)
    claim = SimpleNamespace(found=SimpleNamespace(term=term))
    assert ("payload", 3) not in least(record("none", Arm()), claims=[claim])


def test_a_payload_has_no_inertia_of_its_own_where_rotors_make_up_for_it(  # type: ignore[no-untyped-def]
    record, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two joints at right angles feel it as two rotors; its number was then off by the rotors that
    the joints claimed. The arm has such joints where a brake holds the last one.
    """
    shares = []
    own_share = Solver.own_share
    monkeypatch.setattr(
        Solver, "own_share", lambda *a: shares.append(own_share(*a)) or shares[-1]
    )
    any_inertia = replace(LIMITS, shown=0.0, blurred=1e9)
    free = []
    for name, held in (("at_right_angles", 3), ("all_turn", 0)):
        made = record(name, Arm(mass=1.5, held=held), friction=True)
        found = bodies.find_bodies(*prepared(made), made[0], 1, lambda _: None, any_inertia).found
        free.append([f.explained.hypothesis.free for f in found])
    assert shares[0] < 0.1 * LIMITS.no_rotor and shares[-1] > 10 * LIMITS.no_rotor
    assert free[0] == [("mass", "com_x", "com_y", "com_z")]


def test_the_summary_tells_the_largest_body_of_each_kind_that_may_have_been_missed() -> None:
    ripple = Detectable(1, "position_torque", "ripple", 0.1, "N m", 0.2)
    light = Detectable(3, "inertia", "body", 0.2, "kg", 0.01)
    bodies = [light, replace(light, joint=2, size=0.4), replace(light, effect="payload", size=0.1)]
    told = summary._missed([*[replace(ripple, joint=j) for j in range(1, 6)], *bodies])
    assert "body below 0.4 kg (joint 2)" in told and "payload below 0.1 kg (joint 3)" in told
    assert told.count("ripple") == 3 and told.endswith("and 3 smaller ones")


@pytest.mark.parametrize("fallen", [0.1, 0.15, 0.2])  # of the RMS speed
def test_frictions_beside_a_body_fall_with_the_speed(record, fallen: float) -> None:  # type: ignore[no-untyped-def]
    """Beside a straight line of friction a link 10 % heavier was not seen."""
    fit, _ = prepared(record("none", Arm()))
    joint, speed = fit.records[0][1], fit.records[0][1].scale.speed
    qd = joint.motion.states[1]
    moves = np.abs(qd) > 0.05 * speed
    falling = np.sign(qd) * np.exp(-((qd / (fallen * speed)) ** 2))
    model = kernel_model(record("none", Arm())[0])
    columns = np.stack(_frictions(joint, model, 0.05 * speed, True))
    left = {}
    for name, span in (("all", columns), ("dry, viscous and drag", columns[:4])):
        found = np.linalg.lstsq(span[:, moves].T, falling[moves])[0]
        left[name] = float(np.linalg.norm(falling[moves] - found @ span[:, moves]))
    assert left["all"] < 0.1 * np.linalg.norm(falling[moves])
    assert left["all"] < 0.4 * left["dry, viscous and drag"]


def test_a_friction_beside_a_body_grows_with_the_load(record) -> None:  # type: ignore[no-untyped-def]
    model, paths = record("none", Arm())
    fit, _ = prepared((model, paths))
    joint, speed = fit.records[0][1], fit.records[0][1].scale.speed
    load = _frictions(joint, kernel_model(model), 0.05 * speed, True)[-1]
    inertia, bias = joint.inertia_and_bias(kernel_model(model))
    fast = np.abs(joint.motion.states[1]) > 0.2 * speed
    torque = np.abs(inertia * joint.motion.states[2] + bias) * np.sign(joint.motion.states[1])
    assert np.allclose(load[fast], torque[fast], rtol=1e-3)


def test_a_body_is_looked_for_once_more_without_a_friction_that_grows_with_the_load(
    monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 150 kg at the flange of a real arm nothing was found beside such a friction."""
    asked: list[bool] = []

    def searched(*given: Any) -> Any:
        asked.append(given[3].by_load)
        return SimpleNamespace(found=() if given[3].by_load else ("payload",), strap=None)

    monkeypatch.setattr(bodies, "_by_any_observer", searched)
    monkeypatch.setattr(bodies, "Layout", lambda *_: None)
    links = SimpleNamespace(bodies=(SimpleNamespace(parent=0),))
    data: Any = SimpleNamespace(records=((SimpleNamespace(links=links),),))
    model: Any = None
    found = bodies.find_bodies(data, data, model, 1, lambda _: None)
    assert found.found == ("payload",) and asked == [True, False]


@pytest.mark.parametrize("known", [True, False])
def test_joints_are_searched_without_a_body_once(
    known: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where no proposed body is claimed; a third search of six joints took 12 s."""
    joints_alone: Any = ([], [], "alone")
    asked: list[str] = []
    monkeypatch.setattr(machine, "upon", lambda given, _: SimpleNamespace(terms=(), with_terms=id))
    monkeypatch.setattr(machine, "with_bodies", lambda bare, _: bare)
    monkeypatch.setattr(machine, "explain", lambda *_: asked.append("") or joints_alone)
    monkeypatch.setattr(machine, "_one_body", lambda found, *_: found)
    nothing: Any = None
    bodies: Any = SimpleNamespace(found=[1])
    found = machine.Found(
        nothing, nothing, nothing, bodies, [], [], [], nothing, (),
        without=joints_alone if known else None,
    )  # fmt: skip
    assert machine._claimed_of(found, nothing, 1, print).whole == "alone"
    assert len(asked) == (not known)


@pytest.mark.parametrize("claimed", [True, False])
def test_a_second_body_that_is_none_does_not_hide_the_first(
    claimed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A base tilted by 2 degrees was a gravity at one joint, since a wrong link had been proposed
    with it.
    """
    proposed = [SimpleNamespace(term=name) for name in ("tilt", "link")]
    alone: Any = ([], ["decided"], "alone")
    monkeypatch.setattr(machine, "findings_at", lambda *_: 2)
    monkeypatch.setattr(machine, "with_bodies", lambda bare, _: bare)
    monkeypatch.setattr(machine, "explain", lambda _, __, beneath, *___: (*alone[:2], beneath))
    monkeypatch.setattr(machine, "plainer", lambda *_: False)

    def decided(_parts: Any, search: Any, decisions: Any, _jobs: int) -> tuple[str, ...]:
        assert decisions == ["decided"]
        return tuple(f.term for f in search.found) if claimed else ()

    monkeypatch.setattr(machine, "decide_bodies", decided)
    nothing: Any = SimpleNamespace(test=None)
    beneath: Any = SimpleNamespace(terms=(), with_terms=tuple)
    bodies = machine.BodySearch(nothing, tuple(proposed))  # type: ignore[arg-type]
    apart = machine.Found(nothing, nothing, beneath, bodies, [], *alone, ())
    found = machine._one_body(apart, alone, nothing, 1, print)
    assert found.claims == (("tilt",) if claimed else ())  # type: ignore[comparison-overlap]
    assert found.whole == (("tilt",) if claimed else "alone")  # type: ignore[comparison-overlap]


def test_numbers_that_no_machine_has_are_not_gone_on_with(monkeypatch: pytest.MonkeyPatch) -> None:
    """A link of 0.33 kg that lacked all of it ended the diagnosis with an error."""
    link = Hypothesis("body", 2, "link2", ("mass", "inertia"))
    layout: Any = SimpleNamespace(
        rotors=True, model=SimpleNamespace(terms=(), with_terms=lambda _: None),
        term=lambda _h, values: values, place=lambda *_: None,
    )  # fmt: skip

    class Solver:
        counts = np.ones(1)

        def __init__(self, *_: Any) -> None: ...

        def estimate(self, _h: Hypothesis, values: Any) -> Any:
            return values - 0.2

        def plausible(self, _h: Hypothesis, values: Any) -> bool:
            return bool(values[0] > -0.33)

        def std(self, *_: Any) -> Any:
            return np.array([0.01])

    monkeypatch.setattr(body_numbers, "Sums", lambda *_, **__: None)
    monkeypatch.setattr(body_numbers, "Solver", Solver)
    monkeypatch.setattr(body_numbers, "_known_to", lambda _s, _f, values, _a: values)
    first: Any = SimpleNamespace(hypothesis=link, values=np.array([-0.1, 0.0]))
    nothing: Any = None
    _, values = body_numbers._standing(nothing, layout, first, LIMITS, 1, ())
    assert values[0] == pytest.approx(-0.3)
    one: Any = Solver()
    assert body_numbers.known_by(one, one, first, values)[1][0] == pytest.approx(-0.3)


def test_a_joint_that_is_predicted_to_the_last_digit_outweighs_no_other() -> None:
    """A short recording of an ideal arm ended the diagnosis: what was left of a joint was 0."""
    grams = np.zeros((2, 8, NUISANCE + 2, NUISANCE + 2))
    grams[:, :, NUISANCE:, NUISANCE:] = [[1.0, 1.0], [1.0, 1.0]]  # innovations: the column
    grams[1, :, -1, -1] += 1.0
    both: Any = SimpleNamespace(
        grams=grams, whole=grams.sum(axis=1), counts=np.full((2, 8), 1e6), alike=1
    )
    layout: Any = SimpleNamespace(
        joints=2, width=NUISANCE + 1, own=NUISANCE + 1, rotors=True
    )
    body, nothing = np.zeros((2, NUISANCE + 1)), np.zeros((2, NUISANCE + 1))
    body[:, NUISANCE] = -1.0
    solver = Solver(both, both, layout, LIMITS)
    assert np.isfinite(solver.better(body, nothing)) and solver.better(body, nothing) > LIMITS.sure
