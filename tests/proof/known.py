"""Truths and findings whose judgement is known."""

from __future__ import annotations

from typing import Any

from zendsp.proof.answer import (
    Finding,
)


def truth(
    effects: list[dict[str, Any]], kind: str = "single", verdict: str = "missing", **more: Any
) -> dict[str, Any]:
    return {
        "case": "case_0001",
        "machine": "rotary",
        "kind": kind,
        "verdict": verdict,
        "size": 1.0,
        "effects": effects,
        "replaces": [],
        **more,
    }


def effect(
    name: str, joint: int = 1, accepted: tuple[str, ...] = (), **parameters: float
) -> dict[str, Any]:
    return {
        "effect": name,
        "joint": joint,
        "parameters": {k: {"value": v, "unit": ""} for k, v in parameters.items()},
        "accepted": list(accepted),
        "accepted_joints": [joint],
        "unscored": [],
        "oracle": {"detectable": True, "inseparable": {"delay": 3.0}},
    }


def found(name: str, joint: int = 1, **more: Any) -> Finding:
    return Finding(name, joint, confidence=0.95, **more)
