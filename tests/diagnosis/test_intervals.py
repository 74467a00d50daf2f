"""The intervals of a law's numbers, and torques told from friction: one that wanders, one that
acts one way.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import reality
from reality import RATE
from scipy.signal import lfilter
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.decide.assemble import with_disagreement, with_lasting_torque
from zendsp.diagnosis.decide.thresholds import SURE
from zendsp.diagnosis.measure import bursts as measure_bursts
from zendsp.diagnosis.measure.acting import Acting, Lacking
from zendsp.diagnosis.measure.likelihood import calibrate_joint
from zendsp.diagnosis.measure.wandering import wanders
from zendsp.physics.calibration.covariance import robust_covariance
from zendsp.physics.calibration.fit import Fit, block_count, fit, joint_handles
from zendsp.physics.calibration.handles import Handle


@pytest.mark.parametrize("lasting", [0.0, 0.2])
def test_intervals_hold_the_truth_where_a_random_torque_lasts_longer_than_a_block(
    lasting: float,
) -> None:
    """By the blocks of a fit 70 % of the 90 % intervals held it with the slow torque."""
    rate, n, truth = 100, 3000, np.array([1.0, 0.5])
    data: Any = SimpleNamespace(records=[[SimpleNamespace(n=n, sample_time=1 / rate)]])
    t, rng = np.arange(n) / rate, np.random.default_rng(4)
    jacobian = np.stack([np.sin(0.9 * t), np.sign(np.sin(0.4 * t + 1.0))], axis=1)
    keep = np.exp(-1 / (rate * lasting)) if lasting else 0.0
    model = model_of(VISCOUS, COULOMB)
    handles = (Handle("term", 0, "coefficient"), Handle("term", 1, "level"))
    held = []
    for _ in range(100):
        torque = lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], rng.standard_normal(n))
        x = np.linalg.lstsq(jacobian, jacobian @ truth + torque, rcond=None)[0]
        r = jacobian @ (x - truth) - torque
        blocks = robust_covariance(jacobian, r, block_count(data))
        fitted = Fit(model, handles, x, blocks, float(r @ r), (False, False), jacobian, r)
        std = with_lasting_torque(data, fitted, (1,)).std
        held.append(np.abs(x - truth) < 1.645 * std)
    assert 0.8 < np.mean(held) < 0.97


@pytest.mark.parametrize("what", ["nothing", "friction", "torque"])
def test_a_friction_whose_level_wanders_is_told_from_a_torque_that_does(what: str) -> None:
    """As its own heat makes it wander: a law over time says the same of every recording."""
    columns = reality.simulate(reality.Machine(), reality.multisine(16.0, RATE, 3), RATE)
    speed = np.gradient(np.convolve(columns["q"], np.ones(9) / 9, "same"), columns["t"])
    level = 0.006 * np.sin(2 * np.pi * columns["t"] / 9)
    added = {"nothing": 0.0, "friction": level * np.tanh(speed / 0.05), "torque": level}[what]
    model = model_of(VISCOUS, COULOMB)
    data = data_of({**columns, "u": columns["u"] + added}, model)
    found = wanders(data, calibrate_joint(data, model, 1).model, 1)
    assert (found.z > SURE and found.size > 0.01) is (what == "friction")


@pytest.mark.parametrize(("share", "either"), [(0.0, True), (0.1, True), (1.0, False)])
def test_a_torque_that_acts_one_way_while_the_joint_moves_both_is_no_friction(
    share: float, either: bool
) -> None:
    """A push of 5 % of a disk arm's torque, all of whose time is near reversals, had been taken for
    its friction. ``share``: of a friction in the torque.
    """
    t = np.arange(2000) * 1e-3
    speed = np.cos(2 * np.pi * 3.0 * t)
    torque = (1.0 - share) + share * np.sign(speed)
    record: Any = SimpleNamespace(motion=SimpleNamespace(states=np.stack([t, speed, t])))
    data: Any = SimpleNamespace(records=[[record]])
    of = Lacking(data, (), (torque,), (), (), (slice(None),))
    acting = Acting(of, ((t > 0.5) & (t < 1.5),), 0.0)
    assert measure_bursts._either_way(acting, 1) is either


def test_numbers_on_which_recordings_disagree_are_less_certain() -> None:
    reference = reality.multisine(8.0, RATE, 3)
    model = model_of(VISCOUS, COULOMB)
    one, same, other = (
        data_of(reality.simulate(reality.Machine(coulomb=level), reference, RATE, seed), model)
        for level, seed in ((0.03, 1), (0.03, 2), (0.033, 3))
    )
    fitted = fit(one, model, joint_handles(one, model, 1), joints=(1,))
    at = next(i for i, h in enumerate(fitted.handles) if h.key == "level")
    agreed, apart = (
        with_disagreement(one, held, fitted, (1,), 1).std[at] for held in (same, other)
    )
    assert agreed < 2.0 * fitted.std[at]
    assert apart == pytest.approx(0.003 / np.sqrt(2), rel=0.1)
