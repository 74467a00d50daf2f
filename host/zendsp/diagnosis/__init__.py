"""Diagnosis: where simulation and recording part, what physics was left out, and the fit with it.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

# name -> module that holds it; imported on first use: who only reads a report needs no SciPy
_LAZY = {
    "Diagnosis": "zendsp.diagnosis.result",
    "Estimate": "zendsp.diagnosis.result",
    "Finding": "zendsp.diagnosis.result",
    "FitTable": "zendsp.diagnosis.result",
    "Next": "zendsp.diagnosis.result",
    "Rejected": "zendsp.diagnosis.result",
    "diagnose": "zendsp.diagnosis.engine",
}

if TYPE_CHECKING:
    from zendsp.diagnosis.engine import diagnose as diagnose
    from zendsp.diagnosis.result import Diagnosis as Diagnosis
    from zendsp.diagnosis.result import Estimate as Estimate
    from zendsp.diagnosis.result import Finding as Finding
    from zendsp.diagnosis.result import FitTable as FitTable
    from zendsp.diagnosis.result import Next as Next
    from zendsp.diagnosis.result import Rejected as Rejected

__all__ = sorted(_LAZY)


def __getattr__(name: str) -> Any:
    """Import a public name from its module on first use."""
    if name not in _LAZY:
        raise AttributeError(f"module 'zendsp.diagnosis' has no attribute {name!r}")
    value = getattr(importlib.import_module(_LAZY[name]), name)
    globals()[name] = value
    return value
