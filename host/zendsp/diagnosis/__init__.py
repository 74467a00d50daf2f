"""Diagnosis: where simulation and recording part, what physics was left out, and the fit with it.
"""

from zendsp.diagnosis.engine import diagnose
from zendsp.diagnosis.result import Diagnosis, Estimate, Finding, FitTable, Next, Rejected

__all__ = ["Diagnosis", "Estimate", "Finding", "FitTable", "Next", "Rejected", "diagnose"]
