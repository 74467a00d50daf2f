"""Real recordings are converted right, and their absence is said, never passed over."""

from __future__ import annotations

import hashlib
import io
import os
import threading
import tomllib
import zipfile
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from zendsp.cli.prove import command
from zendsp.proof.answer import Answer, Estimate, Finding
from zendsp.proof.convert import FILES, altered, convert, fetch, missing
from zendsp.proof.real import MACHINES, Seen, look_at, main_status, model_folder, screw_ripple

DATA = Path(os.environ.get("ZENDSP_DATA", "/nowhere"))
with_data = pytest.mark.skipif(
    bool(missing("tx40", DATA)), reason="real recordings: set ZENDSP_DATA"
)


def test_absent_data_are_reported_and_fail(tmp_path: Path) -> None:
    result = CliRunner().invoke(
        command, ["--real", "--data", str(tmp_path / "none"), "--out", str(tmp_path / "o")]
    )
    assert result.exit_code == 1
    assert result.output.count("ABSENT") == len(MACHINES)
    assert "DATA_EMPS.mat" in result.output


def serve(files: dict[str, bytes]) -> tuple[ThreadingHTTPServer, str]:
    """A web server on loopback; its address."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body = files.get(self.path)
            self.send_response(404 if body is None else 200)
            self.end_headers()
            self.wfile.write(body or b"")

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return server, f"http://127.0.0.1:{server.server_port}"


def test_what_is_fetched_gets_into_the_folder_only_with_the_known_hash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pooch")
    table, one, two = b"a,b\n1,2\n", b"first", b"second"
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as made:
        made.writestr("EMPS/one.mat", one)
        made.writestr("EMPS/two.mat", two)
    server, address = serve({"/a.zip": archive.getvalue(), "/t.csv": table, "/wrong.mat": b"other"})
    known = {
        "one.mat": one, "two.mat": two, "t.csv.gz": table, "wrong.mat": b"expected",
        "gone.mat": b"", "bare.mat": b"",
    }
    at = {
        "one.mat": "/a.zip",
        "two.mat": "/a.zip",
        "t.csv.gz": "/t.csv",
        "wrong.mat": "/wrong.mat",
        "gone.mat": "/gone.mat",
    }
    monkeypatch.setitem(
        FILES,
        "emps",
        {f"emps/{n}": hashlib.sha256(content).hexdigest() for n, content in known.items()},
    )
    monkeypatch.setattr(
        "zendsp.proof.convert.ADDRESSES", {f"emps/{n}": address + path for n, path in at.items()}
    )
    told: list[str] = []
    trouble = fetch("emps", tmp_path, told.append)
    server.shutdown()
    assert len(told) == 5
    assert [line.split(":")[0] for line in trouble] == [
        "emps/wrong.mat", "emps/gone.mat", "emps/bare.mat",
    ]
    assert "expected" in trouble[0] and "404" in trouble[1] and "no address" in trouble[2]
    assert all("nonlinearbenchmark.org" in line for line in trouble)
    assert sorted(path.name for path in (tmp_path / "emps").iterdir()) == [
        "one.mat", "t.csv.gz", "two.mat",
    ]
    server.server_close()  # nobody listens there any more
    assert "127.0.0.1 cannot be reached" in fetch("emps", tmp_path)[0]
    assert altered("emps", tmp_path) == []
    (tmp_path / "emps/t.csv.gz").write_bytes(b"not compressed")
    assert altered("emps", tmp_path) == ["emps/t.csv.gz"]


def test_no_folder_named_is_a_usage_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ZENDSP_DATA", raising=False)
    result = CliRunner().invoke(command, ["--implant"])
    assert result.exit_code == 2 and "ZENDSP_DATA" in result.output


def test_absent_machine_makes_the_status_bad(tmp_path: Path) -> None:
    seen = look_at(MACHINES[0], tmp_path, tmp_path / "out", 1.0)
    assert seen.absent and not seen.good and main_status([(MACHINES[0], seen)]) == 1
    assert main_status([]) == 1
    kept = Seen("emps", Answer("missing"), (("x", True),), None)
    assert main_status([(MACHINES[0], kept)]) == 0


def test_given_models_lack_the_physics_and_are_of_the_contract() -> None:
    for name, lacking in (("emps", "coulomb"), ("single_pendulum", "coulomb"), ("tx40", "coulomb")):
        table = tomllib.loads((model_folder() / f"{name}.toml").read_text())
        assert lacking not in {e["kind"] for e in table["effect"]}
        assert (
            table["name"] == name
            and table["sample_time"] == 0.001
            and "position" in table["columns"]
        )
    tx40 = tomllib.loads((model_folder() / "tx40.toml").read_text())
    sensor, actuator = np.array(tx40["sensor"]["matrix"]), np.array(tx40["actuator"]["matrix"])
    # power is the same on both sides: tau_joint . v_joint = tau_motor . v_motor
    assert np.allclose(actuator.T @ sensor, np.eye(6))


def test_only_the_ripple_of_the_screw_counts() -> None:
    def answer(order: float) -> Answer:
        return Answer("missing", (Finding("ripple", 1, {"order": Estimate(order, 1.0)}, 0.9),))

    assert screw_ripple(answer(2 * np.pi / 0.0025)) and not screw_ripple(answer(1000.0))


@with_data
def test_tx40_converts_to_joint_angles_that_start_at_zero(tmp_path: Path) -> None:
    made = convert("tx40", DATA, tmp_path)
    table = tomllib.loads((model_folder() / "tx40.toml").read_text())
    with np.load(made.train[0]) as file:
        joint = file["q_motor"] @ np.array(table["sensor"]["matrix"]).T + np.array(
            table["sensor"]["offset"]
        )
        assert file["tau_motor"].shape == joint.shape == (9000, 6)
    assert np.max(np.abs(joint[0])) < 1e-3
    assert (tmp_path / "tx40.urdf").exists()


@with_data
def test_pendulum_hangs_at_zero(tmp_path: Path) -> None:
    made = convert("single_pendulum", DATA, tmp_path)
    assert len(made.train) == 4 and len(made.heldout) == 2
    with np.load(made.train[0]) as file:
        assert abs(np.mean(file["q"])) < 0.05  # it swings about the hanging position
        slope = np.gradient(file["q"], file["t"])
        assert np.corrcoef(slope, file["qd"])[0, 1] > 0.999
