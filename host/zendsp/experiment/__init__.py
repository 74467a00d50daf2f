"""Identification experiments over the link: each moves a machine, keeps every recording, fits,
draws, and writes a result.
"""

from zendsp.experiment.frequency import frequency_response
from zendsp.experiment.lab import Lab
from zendsp.experiment.model_update import fit_model, put_into
from zendsp.experiment.registry import EXPERIMENTS, Experiment
from zendsp.experiment.response import FrequencyResponse
from zendsp.experiment.result import Estimate, FoundEffect, Result
from zendsp.experiment.running import run_experiment
from zendsp.experiment.sweep import sweep
from zendsp.experiment.sweep_result import Sweep, SweepRun

__all__ = [
    "EXPERIMENTS", "Estimate", "Experiment", "FoundEffect", "FrequencyResponse", "Lab", "Result",
    "Sweep", "SweepRun", "fit_model", "frequency_response", "put_into", "run_experiment", "sweep",
]
