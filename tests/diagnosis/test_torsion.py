"""What the torsion of a transmission shows, on synthetic signals."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from zendsp.diagnosis.decide.claims import Claim as JointClaim
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.measure.discrepancy import Size
from zendsp.diagnosis.report.torsion import _fitted
from zendsp.diagnosis.transmission import one_sensor
from zendsp.diagnosis.transmission.claims import Claim, claims_of
from zendsp.diagnosis.transmission.motor_side import Motor
from zendsp.diagnosis.transmission.sets import Sets, lag_of, torque_scale
from zendsp.diagnosis.transmission.shown import Shown, misread, shown
from zendsp.diagnosis.transmission.terms import applied, choose, fitted, may_be_off
from zendsp.diagnosis.transmission.torsion import Twist, held_drive, lowpass
from zendsp.diagnosis.transmission.torsion_fit import columns_of, rms
from zendsp.diagnosis.transmission.waves import waves_of
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Quantity, Term

Array = npt.NDArray[np.float64]
RATE, SECONDS = 1000.0, 12.0
NOISE = 2e-5  # rad
GIVEN = parse_model(
    {
        "name": "bench",
        "sample_time": 1 / RATE,
        "mechanism": {"kind": "rotary", "parameters": {"inertia": 0.08, "gravity": 1.1}},
        "columns": {"time": "t", "position": "q", "command": "u"},
    }
)


def twist(torsion: Callable[[Array, Array], Array], seed: int, travel: float) -> Twist:
    """A joint that moves over ``travel`` rad; ``torsion`` is a function of its position and torque.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(int(SECONDS * RATE)) / RATE
    f, phase = rng.uniform(0.2, 2.5, 7), rng.uniform(0, 2 * np.pi, 7)
    q = np.sum(np.sin(2 * np.pi * np.outer(t, f) + phase) / (1 + (f / 0.6) ** 1.3), axis=1)
    q *= travel / np.ptp(q)
    qd = np.gradient(q, t)
    qdd = np.gradient(qd, t)
    torque = 0.05 * qdd + 1.1 * np.sin(q)
    kept = np.abs(qd) > 0.02 * np.quantile(np.abs(qd), 0.98)
    y = torsion(q, torque) + NOISE * rng.standard_normal(len(t))
    whole = np.ones(len(t), bool)
    return Twist(
        y, q, qd, qdd, torque, torque, 1 / RATE, NOISE, 0.0, kept, whole, 0.0, 1 / RATE
    )


def sets(torsion: Callable[[Array, Array], Array], travel: float) -> Sets:
    return Sets(*([twist(torsion, seed, travel)] for seed in (1, 2, 3)))


def claimed(torsion: Callable[[Array, Array], Array], travel: float = 3.0) -> dict[str, Claim]:
    slow = sets(torsion, travel).each(lambda t: lowpass(t, 32.0))
    chosen, here, _ = choose(slow, 0.08, Motor(0.03))
    return {c.name: c for c in claims_of(here, chosen, torque_scale(here.fit), GIVEN)}


def test_a_recording_without_kept_rows_is_ignored_for_an_encoder_disc() -> None:
    moving = sets(lambda q, torque: -torque / 40.0, 3.0)
    first = moving.fit[0]
    still = replace(first, kept=np.zeros(len(first.q), bool))  # as between two pushes
    assert may_be_off(Sets([still, first], moving.choose, moving.test))


def on_a_disc(compliance: float, width: float) -> Callable[[Array, Array], Array]:
    """A spring, a step of full ``width`` with direction, and a disc 1 mm off in a radius of 1 m."""

    def torsion(q: Array, torque: Array) -> Array:
        step = 0.5 * width * np.tanh(np.gradient(q, 1 / RATE) / 0.01)
        return np.asarray(-compliance * torque - step + 1e-3 * np.sin(q + 0.7))

    return torsion


def test_an_encoder_disc_is_the_same_in_every_recording() -> None:
    slow = sets(on_a_disc(1e-4, 0.0), 1.0).each(lambda t: lowpass(t, 10.0))
    scale = torque_scale(slow.fit)
    found = fitted(slow.fit, ("spring",), True, scale)
    assert found.x[-2:] == pytest.approx(1e-3 * np.array([np.cos(0.7), np.sin(0.7)]), rel=0.05)
    # also where another recording is too short to tell a disc from a spring
    brief = [replace(t, kept=t.kept & (np.arange(len(t.q)) < 100)) for t in slow.test]
    assert rms(applied(brief, ("spring",), True, scale, found.x)) < 1e-5


def test_the_figure_of_a_spring_shows_the_stated_one_beside_an_encoder_disc() -> None:
    """A KUKA's figure had a fifth of the slope that its sentence states."""
    parts = sets(on_a_disc(1e-4, 0.0), 0.5).each(lambda t: lowpass(t, 10.0)).fit
    scale = torque_scale(parts)
    columns = [columns_of(t, ("spring",), scale)[:, :1] for t in parts]
    found: Any = SimpleNamespace(numbers={"details": {"compliance": 1e-4}})
    fit, beside = _fitted(parts, columns, found, scale)
    assert beside[0].shape[1] == 3 and -fit.x[0] == pytest.approx(1e-4, rel=0.02)
    unstated: Any = SimpleNamespace(numbers={})
    assert _fitted(parts, columns, unstated, scale)[1] is columns


def read(compliance: float, width: float, travel: float) -> Shown:
    slow = sets(on_a_disc(compliance, width), travel).each(lambda t: lowpass(t, 10.0))
    return shown(slow, torque_scale(slow.fit), GIVEN, 1)


@pytest.mark.parametrize(("compliance", "width"), [(0.0, 0.0), (2e-5, 1e-5), (1e-4, 1e-4)])
@pytest.mark.parametrize("travel", [0.5, 1.5])
def test_two_sensors_show_small_numbers_within_their_interval_too(
    compliance: float, width: float, travel: float
) -> None:
    found = read(compliance, width, travel)
    for term, true in (("spring", compliance), ("step", width)):
        told = found.values[term]
        assert abs(told.value - true) < 3.0 * told.std
        assert told.std < found.least[term].value
    sentence, seen = found.unclaimed(1, ["spring"])
    assert "hysteresis" in sentence and "compliance" not in sentence
    assert [d.effect for d in seen] == ["hysteresis"]


def test_a_lag_left_in_reads_as_hysteresis() -> None:
    def late(q: Array, torque: Array) -> Array:
        return np.asarray(-3e-3 * np.gradient(q, 1 / RATE) - 1e-4 * torque)

    raw = sets(late, 1.5)
    assert lag_of(raw, 10.0) == pytest.approx(3e-3, rel=0.02)
    told = misread(raw, 10.0, GIVEN, 1)
    width = float(told.split()[-2])
    assert told.endswith("rad") and width > 1e-3
    slow = raw.each(lambda t: lowpass(t, 10.0))
    assert abs(shown(slow, torque_scale(slow.fit), GIVEN, 1).values["step"].value) < 0.05 * width


def gap(q: Array, torque: Array) -> Array:
    """12 mrad, contacts of 10 000 N m/rad, and a load that takes 50 ms from one to the other."""
    side = np.convolve(np.sign(torque), np.ones(50) / 50)[: len(torque)]
    return np.asarray(-6e-3 * side - torque / 1e4)


def test_the_width_of_a_gap_is_measured_from_rows_in_contact() -> None:
    found = claimed(gap)
    # of all rows at which it may not be open the contact came out a sixth too soft
    assert -2 * found["gap"].value == pytest.approx(0.012, rel=0.005)
    assert -1 / found["spring"].value == pytest.approx(1e4, rel=0.1)


def test_a_gap_of_which_a_weight_presses_one_side_nearly_always_is_no_spring() -> None:
    """Rows that are pressed for long were all on the one side, and showed none of the other."""

    def weighed(torque: Array) -> Array:
        lifted = torque + 1.5 * float(np.sqrt(np.mean(torque**2)))
        # what dips below is brief, as where a joint brakes hard
        return np.asarray(np.where(lifted < 0.0, 3.0 * lifted, lifted))

    def lifted(twist: Twist) -> Twist:
        torque = weighed(twist.torque)
        return replace(twist, torque=torque, drive=torque)

    def torsion(q: Array, torque: Array) -> Array:
        return gap(q, weighed(torque))

    slow = sets(torsion, 3.0).each(lambda t: lowpass(lifted(t), 32.0))
    assert np.mean(slow.fit[0].torque > 0.0) > 0.85
    chosen, here, _ = choose(slow, 0.08, Motor(0.03))
    found = {c.name: c for c in claims_of(here, chosen, torque_scale(here.fit), GIVEN)}
    assert -2 * found["gap"].value == pytest.approx(0.012, rel=0.05)


def late(q: Array, torque: Array) -> Array:
    """1000 N m/rad, where friction of 0.8 N m within the transmission holds."""
    out, at = np.empty_like(torque), 0.0
    for k, here in enumerate(torque):
        at = max(here - 0.8, min(here + 0.8, at))
        out[k] = at
    return -out / 1000.0


def test_friction_before_a_spring_does_not_look_like_an_early_second_sensor() -> None:
    def of_bodies(t: Twist) -> Twist:
        shaken = np.random.default_rng(5).standard_normal(len(t.q))
        noise = 6.0 * np.convolve(shaken, np.ones(40) / 40, "same")  # of accelerations
        return replace(t, drive=t.torque + 0.03 * t.qdd + 1.8 * t.qd, torque=t.torque + noise)

    measured = sets(lambda q, torque: -torque / 500.0, 3.0).each(of_bodies)
    assert lag_of(measured, 10.0) == 0.0  # 3.2 ms early with the drive's torque beside it


def test_a_transmission_with_internal_friction_has_hysteresis() -> None:
    found = claimed(late)
    assert set(found) == {"spring", "loop"}
    assert -found["loop"].value == pytest.approx(0.8e-3, rel=0.1)
    assert -1 / found["spring"].value == pytest.approx(1000.0, rel=0.05)


def test_a_spring_alone_has_no_hysteresis() -> None:
    found = claimed(lambda q, torque: -torque / 1000.0)
    assert set(found) == {"spring"}


def test_an_angle_error_with_one_period_in_the_travel_is_found() -> None:
    """When only two periods and more were looked for, 6 waves had come out as 5.1."""
    raw = sets(lambda q, torque: 1.5e-3 * np.sin(6 * q + 0.7), 1.3)
    (wave,), straight = waves_of(raw, GIVEN)
    assert wave.order == pytest.approx(6.0, abs=0.02)
    assert wave.value == pytest.approx(1.5e-3, rel=0.02)
    left = straight.fit[0].torsion
    assert np.std(left) < 0.1 * 1.5e-3


def test_an_angle_error_with_half_a_period_in_the_travel_is_as_unsure_as_it_is() -> None:
    (found,), _ = waves_of(sets(lambda q, torque: 1e-3 * np.sin(3 * q + 1.2), 1.3), GIVEN)
    # where only a whole period and more was looked for: 0.2066 ± 0.0023 mrad, 4.83 times a turn
    assert abs(found.order - 3) < 3 * found.order_std < 0.5
    assert abs(found.value - 1e-3) < 3 * found.std < 1e-3


def test_the_drives_torque_is_as_late_and_as_limited_as_the_model_says() -> None:
    command = np.r_[np.zeros(50), np.full(50, 3.0)]
    record = SimpleNamespace(command=command, sample_time=1 / RATE)
    mechanism = {"kind": "rotary", "parameters": {"inertia": 0.08}}
    given = parse_model(
        {
            "name": "bench",
            "sample_time": 1 / RATE,
            "mechanism": mechanism,
            "effect": [{"kind": "lag", "joint": 1, "time_constant": 0.01}],
            "actuator": {"limit": 2.0, "delay": 0.005},
            "columns": {"time": "t", "position": "q", "command": "u"},
        }
    )
    drive = held_drive(record, given, 1)  # type: ignore[arg-type]
    assert drive.max() <= 2.0
    assert np.all(drive[:54] == 0.0)
    assert drive[65] == pytest.approx(2.0 * (1 - np.exp(-1.0)), rel=0.1)


@pytest.mark.parametrize(
    ("size", "before", "after", "named"),
    [
        (0.0135, 0.0121, 0.0, True),  # nearly all that lacks swings with its load
        (0.0135, 0.0150, 0.0090, False),  # as much lacks with it
        (0.0300, 0.3000, 0.0100, False),  # friction is most of what lacks
        (0.0040, 0.0040, 0.0, False),  # so much swings in complete machines
    ],
)
def test_a_stiff_spring_is_named_where_the_whole_missing_torque_oscillates_with_it(
    monkeypatch: pytest.MonkeyPatch, size: float, before: float, after: float, named: bool
) -> None:
    """4000 N m/rad at one of three joints had only refined a machine called complete."""
    softest = Detectable(2, "transmission", "elasticity", 6.1e-4, "rad/(N m)", 0.0)
    monkeypatch.setattr(one_sensor, "by_one_sensor", lambda *_args: (softest,))
    spring = Term("elasticity", 2, {"stiffness": Quantity(4000.0), "load_inertia": Quantity(0.15)})
    even: Any = SimpleNamespace(gain=1.0, z=10.0)
    claim = JointClaim("elasticity", "transmission", spring, size, even, 9.0, {}, (), (), ())
    nothing: Any = None
    was, left = Size(before, before, before), Size(after, after, after)
    decision = Decision(
        2, "missing", (claim,), (), nothing, nothing, was, left, nothing, left, nothing, 1.0
    )
    (seen,) = one_sensor.shown(nothing, nothing, [decision])
    assert seen.claims == ((claim,) if named else ())
    moved: Any = SimpleNamespace(undriven=frozenset())
    assert bool(one_sensor.unseen(moved, nothing, [seen])) is not named
