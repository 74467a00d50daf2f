"""The gain that a screen predicts for an effect, over the grid of its numbers."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import cast

import numpy as np
import numpy.typing as npt
import pytest
import reality
from reality import RATE
from small_models import COULOMB, VISCOUS, data_of, model_of

from zendsp.diagnosis.search.screen import Screen, phase_of
from zendsp.physics.calibration.fit import fit, joint_handles, residual
from zendsp.physics.calibration.joint import facts
from zendsp.physics.calibration.terms import grid_of, make_term
from zendsp.physics.effects import get_effect, library
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import Model, Term

Array = npt.NDArray[np.float64]


def test_the_screen_ignores_samples_where_friction_holds_the_joint() -> None:
    """In a motion with rests, gravity of a small motor had promised no gain, and was not fitted."""
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


def test_the_screen_expects_of_an_eccentric_encoder_what_a_prediction_shows() -> None:
    """A prediction begins where the sensor says what it said, so a screen begins there too. A jump
    of 800 counts at the first row had hidden the rest, and a gear's error was named in its place.
    """
    model = model_of(VISCOUS, COULOMB)
    columns = reality.simulate(reality.Machine(), reality.multisine(6.0, RATE, 3), RATE)
    data = data_of(columns, model)
    fitted = fit(data, model, joint_handles(data, model, 1), joints=(1,), iterations=1)
    term = make_term(
        get_effect("encoder_eccentricity"), 1, {"amplitude": 1e-3, "phase": 1.0}
    )
    expected = Screen(data, fitted, 1, (1,)).series([(term,)])[0]
    more = fitted.model.with_terms((*fitted.model.terms, term))
    shown = residual(data, more, (1,)) - residual(data, fitted.model, (1,))
    assert np.linalg.norm(shown - expected) < 0.2 * np.linalg.norm(shown)
    assert abs(expected[0]) < 0.01 * np.max(np.abs(expected))


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


def _axis(*terms: dict[str, object]) -> Model:
    mechanism = {"kind": "linear", "parameters": {"mass": {"value": 0.010}}}
    return parse_model(
        {"sample_time": 1.0 / RATE, "mechanism": mechanism, "effect": list(terms)}
    )


def _between(values: Sequence[float], share: float) -> float:
    """A number within a grid's range, evenly by order of size where the grid is."""
    low, high = min(values), max(values)
    if low > 0.0 and high > 3.0 * low:
        return float(low * (high / low) ** share)
    return low + share * (high - low)


@pytest.mark.parametrize("model", [
    model_of(VISCOUS, COULOMB),
    pytest.param(
        _axis(VISCOUS, COULOMB), marks=pytest.mark.long("a joint has most of an axis' grids")
    ),
])  # fmt: skip
def test_the_screen_finds_numbers_between_the_points_of_its_grid(model: Model) -> None:
    """Friction that repeated every 20 mm on an axis of 0.27 m had been looked for only at 18 and 27
    mm.
    """
    reference = 0.4 + reality.multisine(12.0, RATE, 3)
    data = data_of(reality.simulate(reality.Machine(), reference, RATE), model)
    fitted = fit(data, model, joint_handles(data, model, 1), joints=(1,), iterations=1)
    screen = Screen(data, fitted, 1, (1,))
    draw = np.random.default_rng(1)
    asked = []
    for effect in library().values():
        grid = grid_of(effect, screen.records[0], model)
        present = {t.effect for t in model.terms}
        if len(grid) < 2 or len(grid[0]) != 1 or not screen._applies(effect, present):
            continue
        (name,) = grid[0]
        if not effect.parameter(name).fitted:
            continue
        asked.append(effect.name)
        for share in draw.uniform(size=24):
            point = {name: _between([p[name] for p in grid], share)}
            ways = screen._directions(effect, point)
            sizes = draw.normal(size=len(ways)) if phase_of(effect) else np.ones(len(ways))
            terms = [(make_term(effect, 1, values),) for values in ways]
            column = sizes @ screen.series(terms, alone=bool(effect.replaces))
            column -= screen.q @ (screen.q.T @ column)
            screen.left = -column
            seen = max(gain for gain, _ in screen._at(effect, grid))
            assert seen > 0.5 * float(column @ column), (effect.name, point)
    assert {"position_friction", "ripple", "stribeck", "dead_zone"} <= {*asked}


@pytest.mark.parametrize("each", [1, 2, 3])
def test_a_group_of_columns_promises_what_least_squares_beside_the_calibrated_numbers_gain(
    each: int,
) -> None:
    """Also where the calibrated numbers imitate a column to the last digits, or it is nothing."""
    rng = np.random.default_rng(3)
    q = np.linalg.qr(rng.normal(size=(400, 4)))[0]
    left = rng.normal(size=400)
    left -= q @ (q.T @ left)
    columns = rng.normal(size=(4 * each, 400))
    columns[each] = 1e-6 * columns[each] + q[:, 1]
    columns[2 * each :: each][:1] = 0.0
    columns[-1] = np.inf
    around = cast(Screen, SimpleNamespace(q=q, left=left))
    with np.errstate(invalid="ignore"):
        found = list(Screen.groups(around, columns, each))
    assert len(found) == 4
    for begin, (gain, theta) in zip(range(0, 3 * each, each), found, strict=False):
        beside = columns[begin : begin + each] - (columns[begin : begin + each] @ q) @ q.T
        wanted = np.linalg.lstsq(beside.T, -left, rcond=1e-12)[0]
        np.testing.assert_allclose(theta, wanted, rtol=1e-6)
        assert gain == pytest.approx(left @ left - np.sum((left + wanted @ beside) ** 2), rel=1e-6)
    assert found[-1][0] == 0.0 and not found[-1][1].any()  # not finite: it promises nothing


def test_a_column_promises_its_gain_where_no_number_is_free() -> None:
    """A simulator of which nothing may be calibrated."""
    around = cast(Screen, SimpleNamespace(q=np.zeros((3, 0)), left=np.array([1.0, 2.0, 2.0])))
    ((gain, theta),) = Screen.groups(around, np.array([[0.0, -1.0, 0.0]]), 1)
    assert gain == pytest.approx(4.0) and theta == pytest.approx([2.0])
