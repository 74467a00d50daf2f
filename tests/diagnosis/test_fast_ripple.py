"""Torque ripple that passes faster than the observer of the search can follow."""

from __future__ import annotations

from dataclasses import replace

import pytest
import reality
from reality import FAST
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.decide.fast_ripple import finding_of, fine_ripples
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
    found = fine_ripples(fit, choose, search, 1)
    assert len(found) == (1 if amplitude else 0)
    for ripple in found:
        assert ripple.term.value("order") == pytest.approx(97.0, abs=0.3)
        assert ripple.term.value("amplitude") == pytest.approx(amplitude, rel=0.1)


def test_a_ripple_of_another_phase_in_each_recording_keeps_its_amplitude() -> None:
    """Two recordings of a screw, 1.0 and 0.9 N, were 0.69 ± 0.04 N together: the mean of two phases
    1.7 rad apart.
    """
    model = model_of(VISCOUS, COULOMB, rate=FAST)
    machine = reality.Machine(ripple=0.02, order=97)
    turned = 1.7 / 97.0  # the zero of the position is another one
    runs = []
    for seed, zero in ((5, 0.0), (6, turned), (7, 0.0)):
        run = reality.simulate(machine, reality.multisine(8.0, FAST, seed), FAST, seed)
        runs.append(data_of({**run, "q": run["q"] + zero}, model, FAST))
    fit = replace(runs[0], records=(*runs[0].records, *runs[1].records))
    search = JointSearch(1, calibrate_joint(fit, model, 1))
    (ripple,) = fine_ripples(fit, runs[2], search, 1)
    finding = finding_of(ripple, "rotary")
    size = finding.parameters["amplitude"]
    assert abs(size.value - 0.02) < 2.0 * size.std < 0.004
    assert ripple.term.value("amplitude") < 0.016
    assert "Its phase differs between the recordings" in finding.sentence
