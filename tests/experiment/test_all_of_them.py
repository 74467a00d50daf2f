"""What `zendsp experiment all` does where one of them cannot be made."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from zendsp.cli import experiment as cli
from zendsp.errors import Refused, ZendspError
from zendsp.experiment import swing

NAMES = ("friction", "circle", "mechanical")


def _make_all(target: Any, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The experiments that are begun; a circle is refused."""
    begun: list[str] = []

    def make(name: str, *_: Any) -> None:
        begun.append(name)
        if name == "circle":
            raise Refused("no two neighbouring joints turn about parallel axes")

    monkeypatch.setattr(cli, "_make", make)
    lab: Any = lambda _: None  # noqa: E731
    with pytest.raises(ZendspError) as error:
        cli._make_each(NAMES, lab, None, (), False, target)
    begun.append(str(error.value))
    return begun


def test_one_that_cannot_be_made_keeps_no_other_from_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    target = SimpleNamespace(alive=True, status=lambda: SimpleNamespace(trip=None))
    *begun, said = _make_all(target, monkeypatch)
    assert begun == [*NAMES] and said.startswith("1 of 3 experiments could not be made: circle")
    assert "circle is not made: no two neighbouring joints" in capsys.readouterr().err


@pytest.mark.parametrize("alive", [True, False])
def test_a_machine_that_tripped_or_is_gone_is_not_moved_on(
    alive: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = SimpleNamespace(alive=alive, status=lambda: SimpleNamespace(trip="beyond a limit"))
    *begun, said = _make_all(target, monkeypatch)
    assert begun == ["friction", "circle"] and "parallel axes" in said


def test_a_swing_without_its_extra_says_so_before_anything_moves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It was "no swing is found" on every machine but the shipped one."""
    moved: list[str] = []

    def lacks(*_: Any) -> None:
        raise Refused("the optimal swing needs casadi: pip install 'zendsp[swing]'")

    monkeypatch.setattr(swing, "need", lacks)
    monkeypatch.setattr(swing, "with_values", lambda *_: moved.append("mechanical"))
    lab: Any = SimpleNamespace(machine_of=lambda _: "pivot", shipped=lambda _: "")
    with pytest.raises(Refused, match="needs casadi"):
        swing.swing(lab)
    assert not moved
