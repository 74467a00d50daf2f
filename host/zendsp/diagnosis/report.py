"""Writes the report folder."""

from __future__ import annotations

import json
from pathlib import Path

from zendsp.diagnosis.result import Diagnosis
from zendsp.physics.model_file import model_text


def write_report(d: Diagnosis, out: Path) -> None:
    """report.json, model.toml."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.json").write_text(json.dumps(d.report(), indent=1, ensure_ascii=False, allow_nan=False), encoding="utf-8")
    (out / "model.toml").write_text(model_text(d.improved), encoding="utf-8")
