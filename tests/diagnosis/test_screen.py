"""What a screen promises of an effect, and of which one it promises least."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.search.screen import Screen
from zendsp.physics.calibration.fit import fit, joint_handles
from zendsp.physics.calibration.joint import facts
from zendsp.physics.calibration.terms import make_term
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Term

Array = npt.NDArray[np.float64]


def test_a_screen_asks_for_no_torque_where_friction_holds_the_joint() -> None:
    """Among rests the weight of a small motor promised nothing, and was not among those fitted."""
    reference = np.repeat([0.0, 0.7, 0.1, 0.9, 0.2, 0.6], round(1.5 * RATE))
    machine = reality.Machine(coulomb=0.06, kp=1.0, kd=0.06)
    columns = reality.simulate(machine, reference, RATE)
    for terms, share in (((VISCOUS, {**COULOMB, "level": 0.06}), 0.1), ((VISCOUS,), 1.0)):
        model = model_of(*terms)
        data = data_of(columns, model)
        fitted = fit(data, model, joint_handles(data, model, 1), joints=(1,), iterations=1)
        screen = Screen(data, fitted, 1, (1,))
        still = np.abs(data.records[0][0].motion.states[1]) < 0.1 * screen.floors[0]
        assert np.mean(still) > 0.3
        assert np.max(screen.free[0][still]) <= share


@pytest.mark.parametrize(
    ("effect", "numbers", "free"),
    [
        ("stiffness", {"coefficient": 1.0}, "neutral"),
        ("ripple", {"order": 3.0, "amplitude": 1.0}, "phase"),
    ],
)
def test_the_size_that_would_be_seen_is_that_of_the_worst_phase_or_neutral_position(
    effect: str, numbers: dict[str, float], free: str
) -> None:
    model = model_of(VISCOUS, COULOMB)
    reference = 0.4 + reality.multisine(6.0, RATE, 3)
    data = data_of(reality.simulate(reality.Machine(), reference, RATE), model)
    fitted = fit(data, model, joint_handles(data, model, 1), joints=(1,), iterations=1)
    screen = Screen(data, fitted, 1, (1,))

    def trace(term: Term) -> Array:
        column = screen.series([(term,)])[0]
        out: Array = column - screen.q @ (screen.q.T @ column)
        return out

    sort = get_effect(effect)
    values, column = screen.least_seen(sort, numbers, trace)
    least = float(np.linalg.norm(column))
    assert least == pytest.approx(np.linalg.norm(trace(make_term(sort, 1, values))), rel=0.02)
    place, travel = facts(screen.records[0]).centre, screen.records[0].scale.position
    tried = np.linspace(-0.5, 0.5, 9) * (travel if free == "neutral" else 2 * np.pi)
    sizes = [
        float(np.linalg.norm(trace(make_term(sort, 1, {**numbers, free: place + other}))))
        for other in tried
    ]
    assert least <= 1.02 * min(sizes) < 0.9 * max(sizes)
