"""Waves over the position beyond the grids of the effects: a harmonic drive, a motor's poles."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
import reality
from reality import FAST
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.search.candidates import screened
from zendsp.diagnosis.search.orders import between, finest, outstanding
from zendsp.physics.calibration.fit import Data
from zendsp.physics.calibration.observed import matched, response

MODEL = model_of(VISCOUS, COULOMB, rate=FAST)


@cache
def _recorded(size: float = 1.0, **physics: Any) -> Data:
    """Twelve seconds of a machine, along a motion of so many times the usual size."""
    motion = reality.multisine(12.0, FAST, 5, size=size)
    return data_of(reality.simulate(reality.Machine(**physics), motion, FAST, 5), MODEL, FAST)


def test_one_pass_backwards_says_what_every_torque_has_in_common_with_what_is_left() -> None:
    (record,), = _recorded().records
    r = np.random.default_rng(0)
    torque, left, some = r.standard_normal((3, record.n))
    inertia, damping = 0.01 * (1.2 + np.sin(some)), 0.02 + 0.01 * np.cos(some)
    seen = response(record, 32.0, inertia, damping, torque)[0]
    assert seen @ left == pytest.approx(torque @ matched(record, 32.0, inertia, damping, left))


@pytest.mark.parametrize("order", [97, 121])
def test_a_torque_that_repeats_more_often_than_any_grid_is_screened(order: int) -> None:
    """Of a harmonic drive of ratio 50, whose error and whose motor's ripple repeat 100 times a
    turn, 2 to 3 % of the torque was "no function of the joint's state".
    """
    data = _recorded(ripple=0.01, order=order)
    waves = {"ripple", "transmission_error", "sensor_harmonic"}
    found = screened(data, MODEL, 1, only=frozenset(waves))
    assert {c.effect for _, c in found} == waves
    share, best = found[0]
    assert share > 0.02 and best.effect == "ripple"
    assert best.terms[0].value("order") == pytest.approx(order, abs=1.5)  # a fit does the rest


@pytest.mark.parametrize(("size", "found"), [(8.0, 7.57), (1.0, 8.0)])
def test_a_torque_that_repeats_between_whole_times_a_turn_is_screened_where_turns_show_it(
    size: float, found: float
) -> None:
    """Behind a gear of 7.57, magnets of 6 % of the torque were "no function of the state". A joint
    that turns less than a turn needs no finer grid.
    """
    ((share, best),) = screened(
        _recorded(size, ripple=0.02, order=7.57), MODEL, 1, only=frozenset({"ripple"})
    )
    assert share > 0.05 and best.terms[0].value("order") == pytest.approx(found, abs=0.15)


@pytest.mark.parametrize(("machine", "found"), [({"ripple": 0.02}, 0.45), ({}, None)])
def test_what_repeats_after_several_turns_of_a_motor_is_screened(
    machine: dict[str, float], found: float | None
) -> None:
    """What turns behind a gear does: two periods in the travel were "none of the known laws"."""
    data = _recorded(14.0, order=0.45, **machine)
    ((_, best),) = screened(data, MODEL, 1, only=frozenset({"ripple"}))
    record = data.records[0][0]
    waves = between([record], [np.sin(0.45 * record.motion.states[0])])
    assert waves[0] == pytest.approx(0.45, abs=0.06)
    if found is not None:
        assert best.terms[0].value("order") == pytest.approx(found, abs=0.06)


def test_an_order_stands_out_where_something_repeats_and_seldom_by_chance() -> None:
    (record,), = _recorded().records
    q = record.motion.states[0]
    noise = np.random.default_rng(3).standard_normal((200, record.n))
    by_chance = [bool(outstanding([record], [one])) for one in noise]
    assert np.mean(by_chance) < 0.05  # of several hundred orders each time
    (found,) = outstanding([record], [noise[0] + 0.5 * np.sin(130.0 * q + 1.0)])
    assert found == pytest.approx(130.0, abs=1.5)
    assert outstanding([record], [noise[0] + 0.5 * np.sin(1.1 * finest([record]) * q)]) == []


def test_of_a_machine_without_such_a_wave_no_order_stands_out() -> None:
    """Nor of one whose friction, which nothing describes, is left."""
    others: list[dict[str, float]] = [{}, {"breakaway": 0.01}, {"wave": 0.01}]
    for physics in others:
        found = screened(_recorded(**physics), MODEL, 1, only=frozenset({"ripple"}))
        assert found[0][1].terms[0].value("order") <= 60.0
