"""Diagnosis: where a simulation departs from a recording, which physics was left out, and the fit
with it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from zendsp.first_use import on_first_use

# name -> module that holds it; imported on first use: who only reads a report needs no SciPy
_LAZY = {
    "Diagnosis": "zendsp.diagnosis.decide.result",
    "Estimate": "zendsp.diagnosis.decide.findings",
    "Finding": "zendsp.diagnosis.decide.findings",
    "FitTable": "zendsp.diagnosis.decide.result",
    "Next": "zendsp.diagnosis.decide.result",
    "Rejected": "zendsp.diagnosis.decide.contract",
    "diagnose": "zendsp.diagnosis.engine",
}

if TYPE_CHECKING:
    from zendsp.diagnosis.decide.contract import Rejected as Rejected
    from zendsp.diagnosis.decide.findings import Estimate as Estimate
    from zendsp.diagnosis.decide.findings import Finding as Finding
    from zendsp.diagnosis.decide.result import Diagnosis as Diagnosis
    from zendsp.diagnosis.decide.result import FitTable as FitTable
    from zendsp.diagnosis.decide.result import Next as Next
    from zendsp.diagnosis.engine import diagnose as diagnose

__all__ = sorted(_LAZY)

__getattr__ = on_first_use(__name__, _LAZY)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})
