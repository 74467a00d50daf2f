"""Diagnosis: where simulation and recording part, what physics was left out, and the fit with it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from zendsp.first_use import on_first_use

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

__getattr__ = on_first_use(__name__, _LAZY)
