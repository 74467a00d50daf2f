"""The columns of the search for bodies, and their Gram matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import small_arms
from small_arms import Arm

from zendsp.diagnosis.data.regression import rigid_torques
from zendsp.diagnosis.search.body_columns import NUISANCE, Layout, Sums, product
from zendsp.diagnosis.search.body_hypotheses import Hypothesis
from zendsp.diagnosis.search.body_solver import Solver
from zendsp.physics.calibration.fit import Data
from zendsp.physics.model import Model
from zendsp.physics.robots import rigid
from zendsp.physics.robots.bodies import Links, change_of

PAYLOAD = Hypothesis("payload", 3, "fore", ("mass", "com_x", "com_y", "com_z"))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Data, Model]:
    arm = small_arms.recorded(tmp_path_factory.mktemp("arm"), "arm", Arm(mass=0.5))
    return small_arms.prepared(arm)[0], arm[0]


def test_only_the_columns_of_what_is_asked_for_are_made(
    made: tuple[Data, Model], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A payload's numbers are the same. Those of all links and zeros had taken two thirds of the
    time: zeros need the dynamics of the whole arm once a joint.
    """
    data, model = made
    links = data.records[0][0].links
    assert links is not None
    layout, every = Layout(model, links), Sums(data, model)
    monkeypatch.setattr(Links, "zeros", lambda *_: pytest.fail("no zero was asked for"))
    few = Sums(data, model, about=[PAYLOAD])
    one, other = (Solver(sums, sums, layout) for sums in (every, few))
    values = one.estimate(PAYLOAD)
    assert values[0] == pytest.approx(0.5, rel=0.2)  # friction of its own takes up some of it
    assert other.estimate(PAYLOAD) == pytest.approx(values, rel=1e-6)
    assert other.std(PAYLOAD, values) == pytest.approx(one.std(PAYLOAD, values), rel=1e-6)
    assert not few.whole[:, layout.zero : layout.mechanism].any()
    assert few.whole[0].any(axis=1).sum() < 0.7 * every.whole[0].any(axis=1).sum()


def test_a_torque_in_the_recordings_changes_the_innovations_only(made: tuple[Data, Model]) -> None:
    data, model = made
    sums = Sums(data, model)
    assert sums.whole.shape == sums.grams.shape[:1] + sums.grams.shape[2:]  # known by now
    links = data.records[0][0].links
    assert links is not None
    x = Layout(model, links).place(PAYLOAD, np.array([0.7, 0.1, 0.0, 0.05]))
    lacking = sums.with_torque(x)
    change = np.repeat(np.eye(x.shape[1] + 1)[None], len(x), axis=0)
    change[:, :-1, -1] = -x
    expected = np.swapaxes(change, 1, 2)[:, None] @ sums.grams @ change[:, None]
    assert lacking.grams == pytest.approx(expected, rel=1e-9, abs=1e-12 * sums.grams.max())
    assert np.allclose(lacking.whole, lacking.grams.sum(axis=1), rtol=1e-12)
    some = sums.some(np.arange(sums.counts.shape[1]) < 2)
    assert np.array_equal(some.whole, sums.grams[:, :2].sum(axis=1))
    full = np.append(x[0], 1.0)
    assert product(sums.grams[0], full[None]) == pytest.approx(sums.grams[0] @ full)


def test_the_torques_of_an_arm_need_no_inertias(
    made: tuple[Data, Model], monkeypatch: pytest.MonkeyPatch
) -> None:
    data, model = made
    motion = [record.motion.states for record in data.records[0]]
    each = [basis["fixed"] for basis in rigid.bases(model, motion)]
    expected = [b.inertia * m[2] + b.bias for b, m in zip(each, motion, strict=True)]
    monkeypatch.setattr(rigid, "own_inertias", lambda *_: pytest.fail("nobody asks for them"))
    assert rigid_torques(model, motion) == pytest.approx(np.array(expected), rel=1e-9, abs=1e-9)


WRONG = Hypothesis("body", 2, "upper", ("mass", "com_x", "com_y", "com_z", "inertia"))
TILT = Hypothesis("base_tilt", 0, "", ("angle_x", "angle_y"))


@pytest.mark.parametrize("h", [PAYLOAD, WRONG])
def test_a_hypothesis_of_a_link_is_the_change_that_its_term_makes(
    made: tuple[Data, Model], h: Hypothesis
) -> None:
    data, model = made
    links = data.records[0][0].links
    assert links is not None
    layout, values = Layout(model, links), np.linspace(0.3, 0.1, len(h.free))
    x, at = layout.place(h, values), NUISANCE + 10 * (h.joint - 1)
    own = change_of(layout.term(h, values), links.bodies[h.joint - 1])
    assert np.array_equal(x[:, at : at + 10], np.tile(own, (len(x), 1)))
    x[:, at : at + 10] = 0.0
    assert not x.any()
    wider = layout.place(replace(h, free=(*h.free, "gain")), np.append(values, 0.07))
    assert np.all(wider[:, layout.own] == 0.07)


@pytest.mark.parametrize("h", [PAYLOAD, WRONG, TILT])
def test_the_squares_of_a_hypothesis_in_its_own_numbers_are_those_of_all_columns(
    made: tuple[Data, Model], h: Hypothesis
) -> None:
    """About any numbers, also beside a part that the model has already. By all 90 columns at every
    step, the search for bodies took a third of an arm's time.
    """
    data, model = made
    links = data.records[0][0].links
    assert links is not None
    layout, sums = Layout(model, links), Sums(data, model)
    values = np.linspace(0.02, 0.1, len(h.free))
    had = layout.place(PAYLOAD, np.array([0.4, 0.1, 0.0, 0.02]))
    for solver in (Solver(sums, sums, layout), Solver(sums, sums, layout, origin=had)):
        for here in (0.0 * values, values[::-1]):
            left = solver._about(h, here).left(values)
            assert left == pytest.approx(solver._left(solver.at(h, values)), rel=1e-9)


def test_the_likelihood_of_numbers_is_that_by_all_columns(made: tuple[Data, Model]) -> None:
    data, model = made
    links = data.records[0][0].links
    assert links is not None
    layout, sums = Layout(model, links), Sums(data, model)
    solver = Solver(sums, sums, layout)
    x = solver.at(PAYLOAD, np.array([0.4, 0.1, 0.0, 0.02]))
    full = solver._full(x, solver.chosen)
    left = np.einsum("ja,jbac,jc->jb", full, sums.grams, full)
    mean = left.sum(axis=1) / sums.counts.sum(axis=1)
    expected = left / mean[:, None] + sums.counts * np.log(mean)[:, None]
    assert solver.points(x) == pytest.approx(expected, rel=1e-9)
