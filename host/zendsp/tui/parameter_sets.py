"""Parameter sets as JSON files: values by name, and what they were taken from."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class ParameterSet:
    """Values by variable name."""

    values: Mapping[str, Any]
    machine: str = ""
    program: str = ""
    saved: float = 0.0  # Unix s


def plain(value: Any) -> Any:
    """Return a value of the target as something JSON knows."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    return value


def save_set(path: Path, stored: ParameterSet) -> None:
    """Write a set; the file appears complete or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    body = {
        "values": {name: plain(value) for name, value in stored.values.items()},
        "machine": stored.machine,
        "program": stored.program,
        "saved": stored.saved,
    }
    beside = path.with_suffix(".part")
    beside.write_text(json.dumps(body, indent=1, allow_nan=False) + "\n")
    os.replace(beside, path)


def load_set(path: Path) -> ParameterSet:
    """Read a set.

    Raises
    ------
    ValueError
        The file is no parameter set.
    """
    try:
        body = json.loads(path.read_text())
        values = body.get("values", body)
        if not isinstance(values, dict):
            raise TypeError
        return ParameterSet(values, str(body.get("machine", "")), str(body.get("program", "")), float(body.get("saved", 0.0)))
    except (TypeError, AttributeError, json.JSONDecodeError) as error:
        raise ValueError(f"not a parameter set: expected JSON with an object 'values' ({error})") from error
