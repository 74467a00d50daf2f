"""The compiled kernel: actuators, delays and sensors."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from integrated import (
    J,
    N,
    T,
    command,
    integrate,
    kernel,
    recorded,
    rigid,
)

from zendsp.physics.calibration.predict import run

ACTUATOR: dict[str, tuple[dict[str, float], Callable[[float], float]]] = {
    "torque_gain": ({"ratio": 0.2}, lambda u: 1.2 * u),
    "dead_zone": ({"width": 0.03}, lambda u: math.copysign(max(0.0, abs(u) - 0.03), u)),
    "saturation": ({"level": 0.1}, lambda u: max(-0.1, min(0.1, u))),
}


@pytest.mark.parametrize("name", ACTUATOR)
def test_actuator_maps_act_on_the_command(name: str) -> None:
    parameters, drive = ACTUATOR[name]
    true, without = rigid(lambda *_: 0.0, drive), rigid(lambda *_: 0.0)
    got = kernel(true, [{"kind": name, "joint": 1, **parameters}], 2)
    assert np.max(np.abs(got - true)) < 2e-3 * np.max(np.abs(true - without))


def test_lag_is_a_first_order_actuator() -> None:
    true = integrate(lambda x, t, u: (x[1], x[2] / J, (u - x[2]) / 0.02), 3)[:, 0]
    without = rigid(lambda *_: 0.0)
    got = kernel(true, [{"kind": "lag", "joint": 1, "time_constant": 0.02}], 1)
    assert np.max(np.abs(got - true)) < 1e-6 * np.max(np.abs(true - without))


@pytest.mark.parametrize("name", ACTUATOR)
def test_a_lag_is_asked_for_what_the_drive_gives(name: str) -> None:
    """A current loop or a winding lags behind the limited command."""
    parameters, drive = ACTUATOR[name]
    true = integrate(lambda x, t, u: (x[1], x[2] / J, (drive(u) - x[2]) / 0.005), 3)[:, 0]
    lag = {"kind": "lag", "joint": 1, "time_constant": 0.005}
    got = kernel(true, [lag, {"kind": name, "joint": 1, **parameters}], 1)
    assert np.max(np.abs(got - true)) < 1e-6 * np.max(np.abs(true - rigid(lambda *_: 0.0)))


def moved_by(at: Callable[[float], float]) -> np.ndarray:
    """The rigid joint under the command that ``at`` gives for a time in rows."""
    q, v, true, h = 0.0, 0.0, [], T / 40
    for k in range(N):
        true.append(q)
        for i in range(40):
            a = at(k + (i + 0.5) / 40) / J
            q += h * v + 0.5 * h * h * a
            v += h * a
    return np.array(true)


def acts_as(effect: dict[str, object], reference: np.ndarray) -> None:
    got = kernel(reference, [effect], 1)
    away = np.max(np.abs(reference - rigid(lambda *_: 0.0)))
    assert np.max(np.abs(got - reference)) < 1e-6 * away


def test_delay_of_a_fraction_of_a_sample_is_exact() -> None:
    u, late = command(), 0.0033
    reference = moved_by(lambda row: u[max(math.floor(row - late / T), 0)])
    acts_as({"kind": "delay", "joint": 1, "time": late}, reference)


def test_eccentric_encoder_acts_on_the_measurement_only() -> None:
    true = rigid(lambda *_: 0.0)
    measured = true + 0.03 * np.sin(true + 0.5)
    got = kernel(
        measured, [{"kind": "encoder_eccentricity", "joint": 1, "amplitude": 0.03, "phase": 0.5}], 2
    )
    assert np.max(np.abs(got - measured)) < 0.01 * np.max(np.abs(measured - true))


def test_a_harmonic_of_the_sensor_acts_on_the_measurement_only() -> None:
    order, size, phase = 2.0, 0.03, 0.5
    true = rigid(lambda *_: 0.0)
    seen = size * np.sin(order * true + phase)
    term = {
        "kind": "sensor_harmonic",
        "joint": 1,
        "order": order,
        "amplitude": size,
        "phase": phase,
    }
    got = kernel(true + seen, [term], 2)
    assert np.max(np.abs(got - (true + seen))) < 0.01 * np.ptp(seen)


def test_a_prediction_begins_where_the_sensor_would_say_what_it_said() -> None:
    """It had begun there without the sensor's error: 0.014 rad beside it, and 68 deviations."""
    true = rigid(lambda *_: 0.0)
    seen = true + 0.03 * np.sin(true + 0.5)
    term = {"kind": "encoder_eccentricity", "joint": 1, "amplitude": 0.03, "phase": 0.5}
    model, record = recorded(seen, [term])
    record.motion.states[:, 0] = seen[0], 0.0, 0.0
    off = run(record, model, 16.0, inner=2).innovations / record.gains(16.0)[2]
    assert np.max(np.abs(off)) < 1e-3 * abs(seen[0] - true[0])


@pytest.mark.parametrize(("late", "size"), [(0.03, 0.0), (0.0, 0.03)])
def test_a_free_run_that_begins_in_the_middle_knows_what_the_sensor_makes_of_the_state(
    late: float, size: float
) -> None:
    begin, terms = 300, []
    true = integrate(lambda x, t, u: (x[1], u / J, (x[0] - x[2]) / (late or 1.0)), 3)
    seen = true[:, 2] if late else true[:, 0] + size * np.sin(2 * true[:, 0] + 0.5)
    if late:
        terms.append({"kind": "position_filter", "joint": 1, "time_constant": late})
    else:
        terms.append(
            {"kind": "sensor_harmonic", "joint": 1, "order": 2.0, "amplitude": size, "phase": 0.5}
        )
    model, record = recorded(seen, terms)
    # the smoother's guess of the speed is not what is tested here
    record.motion.states[:2] = seen, np.gradient(seen, T)
    off = np.abs(run(record, model, 16.0, inner=4, free_every=begin).innovations[begin : 2 * begin])
    assert np.max(off) < 0.01 * np.max(np.abs(true[begin : 2 * begin, 0] - seen[begin : 2 * begin]))


def by_rows(x: np.ndarray, late: float) -> np.ndarray:
    """A column through a filter of first order that is computed once a row, begun at rest."""
    out, part = [x[0]], 1 - math.exp(-T / late)
    for value in x[1:]:
        out.append(out[-1] + part * (value - out[-1]))
    return np.array(out)


def test_a_filter_that_is_computed_once_a_row_is_exact() -> None:
    true = rigid(lambda *_: 0.0)
    seen = by_rows(true, 0.0043)
    term = {
        "kind": "position_filter", "joint": 1, "time_constant": 0.0043, "computed": "per_row",
    }  # fmt: skip
    got = kernel(seen, [term], 2)
    assert np.max(np.abs(got - seen)) < 1e-4 * np.max(np.abs(seen - true))


@pytest.mark.parametrize("computed", ["always", "per_row"])
def test_noise_tells_an_observer_as_much_behind_a_filter_as_without(computed: str) -> None:
    """Its gains had been those of a joint that is seen at once: behind a filter of 4 ms the right
    law had 13 % more noise, and lost to a delay (seed 902, case 84)."""
    true, late = rigid(lambda *_: 0.0), 0.0043
    seen = by_rows(true, late)
    if computed == "always":
        seen = integrate(lambda x, t, u: (x[1], u / J, (x[0] - x[2]) / late), 3)[:, 2]
    noise = 1e-4 * np.random.default_rng(0).standard_normal(N)
    term = {"kind": "position_filter", "joint": 1, "time_constant": late, "computed": computed}
    off = []
    for column, terms in ((true, []), (seen, [term])):
        model, record = recorded(column, terms)
        record.motion.states[:, 0] = 0.0
        record.measurement.value[:] = column + noise
        off.append(run(record, model, 64.0, inner=1).innovations / record.gains(64.0)[2])
    assert np.max(np.abs(off[1] - off[0])) < 0.01 * np.std(off[0])


@pytest.mark.parametrize("late", [0.0033, -0.0033])
def test_a_shifted_command_column_acts_at_another_time_either_way(late: float) -> None:
    u = command()  # the column is late: what acts now stands in a later row
    reference = moved_by(lambda row: u[min(max(math.floor(row + late / T), 0), N - 1)])
    acts_as({"kind": "column_shift", "joint": 1, "time": late}, reference)
