"""How long lines stand in a terminal."""

from __future__ import annotations

import io
import shutil

import pytest

from zendsp.cli.lines import fitted


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


COLUMNS = "tau   double[2]  signal  [-10.32, -1.49]  N m  "
ROW = COLUMNS + "commands of both joints, one after another"


@pytest.mark.parametrize(("width", "below"), [(100, None), (80, len(COLUMNS)), (50, 4)])
def test_a_description_is_broken_between_words_and_stands_below_its_column_or_its_row(
    monkeypatch: pytest.MonkeyPatch, width: int, below: int | None
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    assert shutil.get_terminal_size().columns == width
    first, *others = fitted(ROW, Terminal()).split("\n")
    assert all(len(line) <= width for line in (first, *others))
    assert " ".join([first, *(line.strip() for line in others)]).split() == ROW.split()
    if below is None:
        assert (first, others) == (ROW, [])
    else:
        assert others and all(line[:below].isspace() and line[below] != " " for line in others)
