"""Matrices of a control program: declared as C has them, read and written whole or by element."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from samples import run

from zendsp_protocol.errors import VariableError
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime

MODELS = Path(__file__).parents[2] / "examples" / "models"
Make = Callable[..., Runtime]

PROGRAM = """#include "isr.h"
static double K[2][4] = {{1, 2, 3, 4}, {5, 6, 7, 8}}, P[2][2], row[1][3];
static int32_t n[3][2];
static bool on[2][2];
static float v[3] = {1, 2, 3};
void UserInit(void) {
    PARAMETER_ARRAY(K, "N m/rad", -100.0, 100.0, "state feedback");
    PARAMETER(n, 3, "", 0, 9, "");
    PARAMETER(on, true, "", 0, 1, "");
    PARAMETER_ARRAY(row, "", NO_MIN, NO_MAX, "");
    PARAMETER_ARRAY(v, "", NO_MIN, NO_MAX, "");
    SIGNAL(P, "", "");
}
void UserISR_INT2(void) {
    for (int i = 0; i < 2; i++)
        for (int j = 0; j < 2; j++) P[i][j] = 10.0 * i + j + K[i][j];
}
void UserBackground(void) {}
"""


@pytest.fixture
def loaded(make_runtime: Make) -> Runtime:
    return make_runtime(PROGRAM)


def test_a_matrix_is_declared_with_its_rows_and_columns(loaded: Runtime) -> None:
    infos = {i.name: i for i in loaded.variables()}
    shapes = {name: (infos[name].length, infos[name].columns) for name in ("K", "n", "row", "v")}
    assert shapes == {"K": (8, 4), "n": (6, 2), "row": (3, 3), "v": (3, 1)}
    assert infos["on"].type == "bool" and np.shape(infos["on"].initial) == (2, 2)
    assert np.array_equal(infos["K"].initial, [[1, 2, 3, 4], [5, 6, 7, 8]])
    assert np.array_equal(infos["n"].initial, np.full((3, 2), 3))
    assert np.shape(infos["row"].initial) == (1, 3) and np.shape(infos["v"].initial) == (3,)


def test_a_matrix_is_written_and_read_whole_or_by_element(loaded: Runtime) -> None:
    given = np.arange(8.0).reshape(2, 4)
    loaded.write({"K": given}, "me")
    loaded.write({"K[1,2]": 50.0, "K[1]": -1.0}, "me")  # one index counts row after row
    run(loaded, 3)
    given[1, 2], given[0, 1] = 50.0, -1.0
    _, found = loaded.read(("K", "K[1,2]", "P", "P[1,0]"))
    assert np.array_equal(found["K"], given) and found["K[1,2]"] == 50.0
    assert np.array_equal(found["P"], [[0.0, 0.0], [14.0, 16.0]]) and found["P[1,0]"] == 14.0
    change = next(c for c in loaded.log() if c.name == "K")
    assert np.shape(change.old) == (2, 4)


@pytest.mark.parametrize(("value", "said"), [
    ({"K": np.zeros((4, 2))}, r"K: needs shape \(2, 4\) or 8 numbers, got .*\(4, 2\)"),
    ({"K": np.full((2, 4), 101.0)}, r"outside its limits -100 … 100 N m/rad \(element 0,0\)"),
    ({"K[1,3]": 200.0}, r"K\[1,3\]: 200 N m/rad is outside"),
    ({"K[2,0]": 1.0}, r"K has 2 rows of 4"),
    ({"K[0,4]": 1.0}, r"K has 2 rows of 4"),
    ({"v[0,1]": 1.0}, r"v has 3 elements"),
])  # fmt: skip
def test_a_value_that_does_not_fit_a_matrix_is_refused_in_words(
    loaded: Runtime, value: dict[str, object], said: str
) -> None:
    with pytest.raises(VariableError, match=said):
        loaded.write(value, "me")


def test_a_matrix_is_recorded_whole_and_by_element(loaded: Runtime) -> None:
    loaded.acquire_configure(0, AcquireConfig(("P", "P[1,0]"), seconds=0.01))
    assert loaded.acquire_status(0).channels == ("P[0]", "P[1]", "P[2]", "P[3]", "P[1,0]")
    loaded.acquire_start(0)
    run(loaded, 12)
    rows = loaded.acquire_read(0, 0, 10)
    assert np.array_equal(rows[-1], [1.0, 3.0, 15.0, 17.0, 15.0])


def test_matrices_are_declared_without_a_warning(loaded: Runtime) -> None:
    result = loaded.compile({"matrix.c": PROGRAM}, ("-Wall", "-Wextra", "-Wconversion"))
    assert result.ok and not result.diagnostics, result.diagnostics


def test_a_simulated_program_has_the_same_matrices() -> None:
    from zendsp.physics import load_model, simulate

    model = load_model(MODELS / "imi_planar.toml")
    sim = simulate({"matrix.c": PROGRAM}, model, seconds=0.01, channels=["P", "P[1,0]"],
        parameters={"K": [[9.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]]})  # fmt: skip
    assert np.array_equal(sim["P"][-1], [9.0, 3.0, 15.0, 17.0]) and sim["P[1,0]"][-1] == 15.0
    assert sim.parameters["K"] == [[9.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]]


def test_an_array_of_three_dimensions_does_not_compile(loaded: Runtime) -> None:
    text = PROGRAM.replace("P[2][2], ", "P[2][2], deep[2][2][2], ").replace(
        'SIGNAL(P, "", "");', 'SIGNAL(P, "", ""); SIGNAL(deep, "", "");'
    )
    assert not loaded.compile({"deep.c": text}, ()).ok
