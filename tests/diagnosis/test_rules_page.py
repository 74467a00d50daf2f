"""The numbers of docs/diagnosis.md are those that decide."""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path

import pytest

from zendsp.diagnosis.decide import contract, thresholds

PAGE = Path(__file__).parents[2] / "docs" / "diagnosis.md"
ROWS = re.findall(r"^\| `([A-Z_]+)` \| ([0-9./]+) \|", PAGE.read_text(), re.MULTILINE)


@pytest.mark.parametrize(("name", "value"), ROWS)
def test_the_page_states_the_number_that_decides(name: str, value: str) -> None:
    module = thresholds if hasattr(thresholds, name) else contract
    assert getattr(module, name) == float(Fraction(value))


def test_the_text_names_numbers_of_the_table_only() -> None:
    section = PAGE.read_text().partition("## How it decides")[2].partition("### The numbers")[0]
    named = set(re.findall(r"`([A-Z_]{3,})`", section))
    assert len(named) > 10 and named <= {name for name, _ in ROWS}
