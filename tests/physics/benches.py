"""Models of machines that tests simulate."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from zendsp.physics import library, parse_model
from zendsp.physics.model import Model, Quantity, Term

MODELS = Path(__file__).parents[2] / "examples" / "models"
STRICT = ("-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror")  # for C that is generated
T = 0.001  # s between samples


def effect(kind: str, joint: int = 1, **values: float) -> dict[str, Any]:
    return {"kind": kind, "joint": joint, **values}


def rotary(
    *effects: dict[str, Any], inertia: float = 0.01, gravity: float = 0.0, **tables: Any
) -> Model:
    return parse_model(
        {
            "name": "bench",
            "sample_time": T,
            "effect": list(effects),
            "mechanism": {"kind": "rotary", "parameters": {"inertia": inertia, "gravity": gravity}},
            **tables,
        }
    )


def planar(*effects: dict[str, Any], **tables: Any) -> Model:
    parameters = {"p1": 3.473, "p2": 0.196, "p3": 0.242}
    return parse_model(
        {
            "name": "arm",
            "sample_time": T,
            "effect": list(effects),
            "mechanism": {"kind": "planar2r", "parameters": parameters},
            **tables,
        }
    )


def two_joints(*effects: dict[str, Any], **tables: Any) -> Model:
    """Two motors that know nothing of each other but for ``effects``."""
    return parse_model(
        {
            "sample_time": T,
            "effect": list(effects),
            "mechanism": {"kind": "rotary", "parameters": {"inertia": [0.01, 0.02]}},
            "columns": {"position": ["a", "b"]},
            **tables,
        }
    )


def every_effect() -> list[Term]:
    numbers = {
        "from_joint": 2.0, "law": 1.0, "order": 7.0, "period": 0.5, "exponent": 2.0,
        "velocity": 0.3, "split": 0.7, "smooth": 0.05,
    }
    return [
        Term(
            e.name,
            1,
            {
                p.name: Quantity(numbers.get(p.name, 0.11 + 0.01 * k))
                for k, p in enumerate(e.parameters)
            },
        )
        for e in library().values()
    ]
