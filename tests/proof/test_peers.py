"""The peers get a fair chance: on an easy case they name what is there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from zendsp.proof.build_case import Request
from zendsp.proof.cases import write_all
from zendsp.proof.peers import (
    Problem,
    ask_peer,
    available,
    choose,
    frols,
    motion,
    problems,
    sysidentpy_trouble,
    together,
)
from zendsp.proof.tables import read_case


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("peers")
    requests = [
        Request(65, "single", "rotary", "stiffness", 1.0),
        Request(63, "single", "linear", "viscous_asymmetry", 1.0),
    ]
    write_all(requests, root / "cases", root / "truth")
    return sorted((root / "cases").iterdir())


def test_recordings_of_every_format_are_read(folders: list[Path], tmp_path: Path) -> None:
    from zendsp.proof.files import save
    from zendsp.proof.reality import Run
    from zendsp.proof.tables import read_recording

    x = np.random.default_rng(0).normal(size=(50, 2))
    run = Run(np.arange(50) * 1e-3, x, 2 * x, 3 * x, x, x, x[:, 0])
    for form in ("csv", "npz", "mat", "parquet", "h5"):
        columns = {
            "time": "t",
            "position": ["q1", "q2"],
            "command": ["u1", "u2"],
            "reference": ["r1", "r2"],
        }
        table = read_recording(save(tmp_path, form, form, run, columns), columns)
        assert np.allclose(table.position, x, atol=1e-9) and np.allclose(
            table.command, 2 * x, atol=1e-9
        )


def test_inverse_dynamics_of_the_peers_sees_the_true_inertia(folders: list[Path]) -> None:
    """Free columns explain nearly all torque where only a stiffness is missing: filter and timing
    are right.
    """
    p = problems(folders[0])[0]
    model, train, _ = read_case(folders[0])
    m = motion(train[0], model)
    tau = together(m.tau, m.t)[:, 0]
    x = p.x[:, [p.names.index("stiffness"), p.names.index("torque_offset")]]  # k (q - q0)
    left = np.sqrt(np.mean((p.y - x @ np.linalg.lstsq(x, p.y, rcond=None)[0]) ** 2)) / np.std(tau)
    assert left < 0.05  # 14 bits differentiated twice within 20 Hz leave 3 % here


def test_frols_names_an_effect_of_full_size(folders: list[Path]) -> None:
    answer = ask_peer("FROLS", folders[1])
    assert answer.verdict == "missing" and answer.findings[0].effect == "viscous_asymmetry"


def test_every_peer_that_is_installed_answers(folders: list[Path]) -> None:
    pytest.importorskip("pysindy")
    pytest.importorskip("sysidentpy")
    assert available() == {"FROLS": "", "PySINDy STLSQ": ""}
    assert "No module" not in sysidentpy_trouble()
    for method in available():
        answers = [ask_peer(method, folder) for folder in folders]
        assert [answer.trouble for answer in answers] == ["", ""], method
        assert {answer.verdict for answer in answers} <= {"missing", "complete"}, method


def test_frols_orders_terms_by_what_they_explain() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=(400, 5))
    y = 3 * x[:, 3] + 1 * x[:, 1] + 0.01 * rng.normal(size=400)
    p = Problem(0, ("a", "b", "c", "d", "e"), x, y, x, y)
    coef, order = frols(p)[1]
    assert order == [3, 1] and coef[3] == pytest.approx(3, abs=0.01)
    assert choose(p, frols(p))[1] == ["d", "b"]


def test_a_peer_may_answer_that_nothing_is_missing() -> None:
    rng = np.random.default_rng(2)
    x, xt = rng.normal(size=(2, 400, 5))
    y, yt = rng.normal(size=(2, 400))
    p = Problem(0, ("a", "b", "c", "d", "e"), x, y, xt, yt)
    assert choose(p, frols(p)) == (0.0, [])
