"""Torque ripple that passes faster than the observer of the search can follow."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest
import reality
from reality import FAST
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.decide import fast_ripple
from zendsp.diagnosis.decide.fast_ripple import finding_of, fine_ripples
from zendsp.diagnosis.decide.findings import Estimate
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


@pytest.mark.parametrize(("std", "surely"), [(0.025, False), (0.0031, True)])
def test_a_ripple_whose_amplitude_may_be_nothing_is_none(
    std: float, surely: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a supply's limit 0.066 ± 0.025 N m at 1824.0 ± 2.0 times a turn, of a phase known to
    2.6 rad, stood with a confidence of 0.9. Ripples of real machines have 9 and 21 deviations.
    """
    amplitude = {"amplitude": Estimate(0.066, std, "N m")}
    monkeypatch.setattr(fast_ripple, "estimates", lambda *_: amplitude)
    fitted: Any = SimpleNamespace(model=SimpleNamespace(terms=(None,)))
    assert fast_ripple._surely(fitted) is surely


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
