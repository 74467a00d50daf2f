"""What the tests of several packages share."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from zendsp.cli import main
from zendsp.reference import load_machine

# helpers beside the tests, and waiting.py
HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), *(str(room) for room in HERE.iterdir() if room.is_dir())]

# What the tests of a part leave behind is looked through for cycles rarely: with every few hundred
# new objects it took a quarter of the terminal's tests (64 s of the processor, now 44).
gc.freeze()
gc.set_threshold(20_000, 20, 100)

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Started in the background of a shell: what the tests start would inherit it, and not end at
    # Ctrl-C.
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture
def own_registry(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tests neither see nor disturb targets that really run here."""
    monkeypatch.setenv("ZENDSP_RUNTIME_DIR", str(tmp_path_factory.mktemp("registry")))
    for name in ("ZENDSP_CONNECT", "ZENDSP_TARGET"):
        monkeypatch.delenv(name, raising=False)


@pytest.fixture(autouse=True)
def _alone(request: pytest.FixtureRequest) -> None:
    if request.path.parent.name in ("e2e", "experiment", "host"):
        request.getfixturevalue("own_registry")


@pytest.fixture
def typed(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[object, str, str]]:
    """Type a command of `zendsp`: exit status, standard output, standard error."""

    def give(*words: object) -> tuple[object, str, str]:
        monkeypatch.setattr(sys, "argv", ["zendsp", *map(str, words)])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, *capsys.readouterr()

    return give


@pytest.fixture
def wam_of_pinocchio() -> Any:
    """The seven-joint arm as a ``pinocchio.Model``, built from its Denavit-Hartenberg table."""
    import pinocchio as pin

    parameters = load_machine("wam7").parameters
    model = pin.Model()
    model.gravity.linear = np.array(parameters["gravity"], dtype=np.float64)
    placement, parent = pin.SE3.Identity(), 0
    for k, link in enumerate(parameters["link"], start=1):
        parent = model.addJoint(parent, pin.JointModelRZ(), placement, f"joint{k}")
        alpha = np.deg2rad(link["alpha_deg"])
        c, s = np.round(np.cos(alpha), 15), np.round(np.sin(alpha), 15)
        rotation = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
        placement = pin.SE3(rotation, np.array([link["a"], 0.0, link["d"]]))
        xx, yy, zz, xy, xz, yz = link["inertia"]
        about_com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        body = pin.Inertia(link["mass"], np.array(link["com"]), about_com)
        model.appendBodyToJoint(parent, body, placement)
    return model
