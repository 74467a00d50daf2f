"""docs/models.md says what the code does: its model file loads."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from zendsp.physics import parse_model

DOCS = Path(__file__).parents[2] / "docs"


def test_the_model_file_of_the_page_loads() -> None:
    match = re.search(r"```toml\n(.*?)```", (DOCS / "models.md").read_text(), re.DOTALL)
    assert match is not None
    model = parse_model(tomllib.loads(match[1]))
    assert (model.kind, model.joints, model.sample_time) == ("rotary", 1, 0.001)
    assert [term.effect for term in model.terms] == ["viscous"]
