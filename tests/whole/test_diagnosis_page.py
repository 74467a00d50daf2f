"""docs/diagnosis.md says what the code does: its table is the library's, its model file loads."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

from zendsp.physics import parse_model

DOCS = Path(__file__).parents[2] / "docs"


def test_the_table_of_effects_is_that_of_the_library() -> None:
    # in an interpreter of its own: other tests add effects to this one
    code = f"import sys; sys.path.insert(0, {str(DOCS)!r}); import generate_effects as g; sys.exit(g.text() != g.FILE.read_text(encoding='utf-8'))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0, "run: python docs/generate_effects.py"
    assert "| `coulomb` | Fc sign(q̇) | `level` (N m) |" in (DOCS / "diagnosis.md").read_text(encoding="utf-8")


def test_the_model_file_of_the_page_loads() -> None:
    match = re.search(r"```toml\n(.*?)```", (DOCS / "diagnosis.md").read_text(), re.DOTALL)
    assert match is not None
    model = parse_model(tomllib.loads(match[1]))
    assert (model.kind, model.joints, model.sample_time) == ("rotary", 1, 0.001)
    assert [term.effect for term in model.terms] == ["viscous"]
