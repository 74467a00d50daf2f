"""Torque ripple that passes faster than the observer of the search can follow."""

from __future__ import annotations

import pytest
import reality
from reality import FAST
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.decide.fast_ripple import fine_ripples
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.search.hypothesis import JointSearch


@pytest.mark.parametrize("amplitude", [0.02, 0.0])
def test_motor_cogging_behind_a_gear_is_found_beyond_the_grid_of_the_screen(
    amplitude: float
) -> None:
    """A motor behind a gear of ratio 48.5 cogs twice per motor turn."""
    model = model_of(VISCOUS, COULOMB, rate=FAST)
    machine = reality.Machine(ripple=amplitude, order=97)
    fit, choose = (
        data_of(
            reality.simulate(machine, reality.multisine(8.0, FAST, seed), FAST, seed), model, FAST
        )
        for seed in (5, 6)
    )
    search = JointSearch(1, calibrate_joint(fit, model, 1))
    found = fine_ripples(fit, choose, search, "rotary", 1)
    assert len(found) == (1 if amplitude else 0)
    for ripple in found:
        assert ripple.term.value("order") == pytest.approx(97.0, abs=0.3)
        assert ripple.term.value("amplitude") == pytest.approx(amplitude, rel=0.1)
