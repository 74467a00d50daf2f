"""Units as people write them."""

from __future__ import annotations

import numpy as np
import pytest

from zendsp.recording.units import dimension, to_si, unit_in_name


@pytest.mark.parametrize(
    ("written", "factor", "si"),
    [
        ("deg", np.pi / 180, "rad"),
        ("deg/s", np.pi / 180, "rad/s"),
        ("°/s²", np.pi / 180, "rad/s^2"),
        ("rpm", np.pi / 30, "rad/s"),
        ("ms", 1e-3, "s"),
        ("µs", 1e-6, "s"),
        ("mN m", 1e-3, "N m"),
        ("mNm", 1e-3, "N m"),
        ("N·mm", 1e-3, "N m"),
        ("N*m", 1.0, "N m"),
        ("N-m", 1.0, "N m"),
        ("kg.m2", 1.0, "kg m2"),
        ("Ncm", 1e-2, "N m"),
        ("arcsec", np.pi / 648000, "rad"),
        ("mA", 1e-3, "A"),
        ("mm/s", 1e-3, "m/s"),
        ("kN", 1e3, "N"),
        ("rad/s", 1.0, "rad/s"),
        ("Nm", 1.0, "Nm"),
        ("counts", 1.0, "counts"),
    ],
)
def test_units_are_converted_by_their_factor(written: str, factor: float, si: str) -> None:
    found = to_si(written)
    assert found is not None and found[0] == pytest.approx(factor, rel=1e-12) and found[1] == si


@pytest.mark.parametrize("unknown", ["furlong", "", "rad/", "°F", "mol", "q1"])
def test_a_unit_that_is_not_known_is_not_guessed(unknown: str) -> None:
    assert to_si(unknown) is None


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("zeit_ms", "ms"),
        ("Time_rel_ms", "ms"),
        ("log.time_us", "us"),
        ("tiempo_s", "s"),
        ("v_ms", ""),
        ("times_ms", ""),
        ("drift_ms", ""),
        ("torque_Nm", "N m"),
        ("gap_nm", ""),
        ("joint.q_rad", "rad"),
        ("ActPos_mrad", "mrad"),
        ("torque_N_m", "N m"),
    ],
)
def test_ms_means_milliseconds_where_the_name_says_time(name: str, unit: str) -> None:
    assert unit_in_name(name) == unit


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("qDeg", "deg"), ("q.deg", "deg"), ("pos:grad", "deg"), ("q1Deg[0]", "deg"),
        ("speedRpm", "rpm"), ("timeMs", "ms"), ("vMs", ""), ("Deg", ""), ("qDegree", ""),
        ("fooled", ""), ("stamp.sec", "s"), ("motor.mode", ""),
    ],
)
def test_a_unit_at_the_end_of_a_name_is_told_by_a_dot_a_colon_or_a_capital_too(
    name: str, unit: str
) -> None:
    assert unit_in_name(name) == unit


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("pos_rad", "rad"), ("torque_Nm", "N m"), ("qd_rad_s", ""), ("gap_nm", ""), ("rad", ""),
        ("q.rad", "rad"), ("posRad", "rad"), ("tauNm", "N m"), ("conRad", "rad"), ("RAD", ""),
    ],
)
def test_radians_and_newton_metres_at_the_end_of_a_name_are_its_unit(name: str, unit: str) -> None:
    assert unit_in_name(name) == unit


@pytest.mark.parametrize(
    ("one", "other", "alike"),
    [
        ("N m", "mNm", True),
        ("N*m", "kg m^2/s^2", True),
        ("rpm", "rad/s", True),
        ("rad", "deg", True),
        ("V", "W/A", True),
        ("Nmm", "N", False),
        ("rad", "m", False),
        ("A", "V", False),
        ("counts", "rad", False),
    ],
)
def test_units_of_one_kind_have_the_same_dimension(one: str, other: str, alike: bool) -> None:
    assert dimension(one) is not None and dimension(other) is not None
    assert (dimension(one) == dimension(other)) == alike


def test_a_unit_that_is_not_known_has_no_dimension() -> None:
    assert dimension("furlong") is None and dimension("") is None and dimension("rad/") is None
