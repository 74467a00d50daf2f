"""What a search does with a step: equal directions are one, gaps are begun from the given numbers
too, untouched recordings refuse what only the fit wants.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import reality

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import Signals
from zendsp.diagnosis.measure.discrepancy import deviation
from zendsp.diagnosis.measure.evidence import compare
from zendsp.diagnosis.measure.likelihood import (
    Scored,
    calibrate_joint,
    deviance,
    fit_scored,
    informative,
)
from zendsp.diagnosis.search.candidates import as_given, simulated
from zendsp.diagnosis.search.hypothesis import JointSearch, Rival, Step
from zendsp.diagnosis.search.screen import Candidate, with_candidate
from zendsp.diagnosis.search.simplify import simplify
from zendsp.physics.fit import Data, joint_handles
from zendsp.physics.model import Model
from zendsp.physics.model_file import parse_model

RATE = 500.0


def data_of(columns: dict[str, np.ndarray], model: Model) -> Data:
    signals = Signals(
        "run",
        columns["t"],
        1.0 / RATE,
        columns["q"][:, None],
        columns["u"][:, None],
        None,
        np.array([reality.RESOLUTION]),
    )
    return prepare([signals], model, 64.0)


def model_of(*terms: dict[str, object], inertia: float = 0.010) -> Model:
    return parse_model(
        {
            "sample_time": 1.0 / RATE,
            "mechanism": {"kind": "rotary", "parameters": {"inertia": {"value": inertia}}},
            "effect": list(terms),
        }
    )


VISCOUS = {"kind": "viscous", "joint": 1, "coefficient": 0.004}
COULOMB = {"kind": "coulomb", "joint": 1, "level": 0.03}


@pytest.mark.parametrize(("offset", "kept"), [(0.0, "coulomb"), (0.01, "coulomb_asymmetry")])
def test_an_asymmetry_of_equal_directions_is_the_symmetric_effect_and_another_one_stays(
    offset: float, kept: str
) -> None:
    columns = reality.simulate(reality.Machine(), reality.multisine(6.0, RATE, 3), RATE)
    # what the machine was told besides is what one direction had to overcome more
    columns["u"] = columns["u"] + offset
    base = model_of(VISCOUS, COULOMB)
    data = data_of(columns, base)
    calibrated = calibrate_joint(data, base, 1)
    model = model_of(
        VISCOUS, {"kind": "coulomb_asymmetry", "joint": 1, "level_pos": 0.03, "level_neg": 0.03}
    )
    scored = fit_scored(calibrated.data, model, joint_handles(data, model, 1), (1,))
    rival = Rival("coulomb_asymmetry", 1, scored, 10.0, model.at(1)[1:], ("coulomb",))
    best, _ = simplify(
        JointSearch(1, calibrated, [Step(rival, (), calibrated)], scored), informative(data, 1), 1
    )
    assert kept in {t.effect for t in best.model.terms}
    assert {t.effect for t in best.model.terms} <= {"viscous", kept}


def test_a_gap_is_begun_from_the_given_inertia_where_calibration_moved_it() -> None:
    given = model_of(VISCOUS, COULOMB)
    columns = reality.simulate(
        reality.Machine(gap=0.05, load=0.005), reality.multisine(6.0, RATE, 3), RATE
    )
    data = data_of(columns, given)
    moved = given.mechanism["inertia"][0]
    calibrated = model_of(VISCOUS, {**COULOMB, "level": 0.05}, inertia=0.007)
    assert as_given(calibrated, given) == given
    (group,) = simulated(data, calibrated, 1, frozenset({"backlash"}), 1, given)
    (plain,) = simulated(data, calibrated, 1, frozenset({"backlash"}), 1)
    assert all(c.beneath is None for c in plain)
    begun = [c.beneath for c in group if c.beneath is not None]
    assert begun and all(b.mechanism["inertia"][0] == moved for b in begun)

    def best(candidates: list[Candidate]) -> float:
        return min(deviance(data, with_candidate(calibrated, c), (1,)) for c in candidates)

    assert best(group) < best(plain) - 100.0


def test_a_term_that_only_the_fit_wants_does_not_pass_an_untouched_recording() -> None:
    model = model_of(VISCOUS, COULOMB)
    data = data_of(
        reality.simulate(reality.Machine(), reality.multisine(6.0, RATE, 5), RATE), model
    )
    other = data_of(
        reality.simulate(reality.Machine(), reality.multisine(6.0, RATE, 6), RATE, 6), model
    )
    right = calibrate_joint(data, model, 1)
    without = model_of(VISCOUS)
    worse = fit_scored(right.data, without, joint_handles(data, without, 1), (1,))
    seen = compare(worse, right, other, 1)
    assert seen.gain > 100.0 and seen.z > 4.0
    spoiled = Scored(right.fit, right.data, right.deviance, (1,))
    spoiled = replace(
        spoiled, fit=replace(right.fit, model=model_of(VISCOUS, {**COULOMB, "level": 0.05}))
    )
    assert compare(right, spoiled, other, 1).gain < -100.0


def test_neighbouring_blocks_that_resemble_each_other_count_for_less() -> None:
    alone = np.random.default_rng(1).standard_normal(4000)
    in_fives = np.repeat(alone[:800], 5)
    assert deviation(alone) == pytest.approx(np.sqrt(4000), rel=0.1)
    assert deviation(in_fives) > 1.8 * np.sqrt(4000)  # that of 800 sums of five: 2.2 times
