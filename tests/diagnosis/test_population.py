"""The rough cost of a gap: populations go on where a fit has ended."""

from __future__ import annotations

import numpy as np
import pytest
import reality
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.measure.likelihood import Scored, fit_scored
from zendsp.diagnosis.search.backlash import SPREAD
from zendsp.diagnosis.search.population import likeliest
from zendsp.diagnosis.search.rounds import Rounds
from zendsp.diagnosis.search.screen import Candidate
from zendsp.physics.calibration.fit import Data, joint_handles
from zendsp.physics.calibration.handles import get_values
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model

GAP, LOAD, STIFFNESS = 0.0095, 0.0046, 120.0
WORTH = 50.0


@pytest.fixture(scope="module")
def ended() -> Scored:
    """A fit of a gap that ended in a false minimum: half the stiffness, six times the damping."""
    machine = reality.Machine(
        gap=GAP, load=LOAD, coulomb=0.01, kp=3.3, kd=0.02, resolution=2 * np.pi / 4096
    )
    columns = reality.simulate(machine, reality.multisine(16.0, reality.FAST, 3), reality.FAST)
    poor = {
        "kind": "backlash", "joint": 1, "gap": 0.7 * GAP, "stiffness": 20.0,
        "load_inertia": 1.1 * LOAD, "damping": 0.5,
    }  # fmt: skip
    model = model_of(VISCOUS, {**COULOMB, "level": 0.01}, poor, rate=reality.FAST)
    data = data_of(columns, model, reality.FAST)
    return fit_scored(data, model, joint_handles(data, model, 1), (1,), jobs=1)


def _found(data: Data, begin: Model) -> Model:
    handles = joint_handles(data, begin, 1)
    spread = np.diag([SPREAD.get(h.key, 0.05) ** 2 for h in handles])
    return likeliest(data, begin, handles, 1, spread, WORTH, 1)


def test_populations_reach_a_gap_at_which_no_fit_arrives(ended: Scored) -> None:
    handles = joint_handles(ended.data, ended.model, 1)
    again = fit_scored(ended.data, ended.model, handles, (1,), jobs=1, iterations=40)
    assert again.deviance > ended.deviance - WORTH
    model = _found(ended.data, ended.model)
    found = fit_scored(ended.data, model, handles, (1,), jobs=1)
    assert found.deviance < ended.deviance - 3000.0
    (term,) = [t for t in found.model.terms if t.effect == "backlash"]
    assert term.value("gap") == pytest.approx(GAP, rel=0.03)
    assert term.value("stiffness") == pytest.approx(STIFFNESS, rel=0.1)
    assert term.value("load_inertia") == pytest.approx(LOAD, rel=0.03)


def test_populations_say_the_same_each_time_and_leave_a_minimum_as_it_is(ended: Scored) -> None:
    first, second = _found(ended.data, ended.model), _found(ended.data, ended.model)
    handles = joint_handles(ended.data, first, 1)
    assert np.array_equal(get_values(first, handles), get_values(second, handles))
    least = fit_scored(ended.data, first, handles, (1,), jobs=1)
    assert _found(least.data, least.model) is least.model


def test_a_gap_keeps_its_numbers_in_the_first_fit_of_another_law(ended: Scored) -> None:
    """A cubic spring of nothing gained 760 by what it did to a gap, and a second round began."""
    drag = make_term(get_effect("quadratic_drag"), 1, {"coefficient": 1e-5})
    candidate = Candidate("quadratic_drag", 1, (drag,), (), 1.0)
    rounds = Rounds(ended.data, 1, 1, lambda _: None)
    tried = rounds.short.quick(ended, [candidate])
    assert tried is not None
    fitted = {h.key for h in tried.scored.fit.handles}
    assert {"coefficient", "level"} <= fitted and not fitted & {"gap", "stiffness", "load_inertia"}
    whole = rounds._full(ended, tried, 0.0)
    assert {"coefficient", "level", "gap", "stiffness"} <= {h.key for h in whole.scored.fit.handles}
