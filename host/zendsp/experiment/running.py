"""Runs an experiment of the list by its name."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable

from zendsp.experiment.early_end import forget_early
from zendsp.experiment.lab import Lab
from zendsp.experiment.registry import experiment_named
from zendsp.experiment.result import Result


def run_experiment(name: str, lab: Lab) -> Result:
    """Run an experiment by name and return its result. Recordings, figure and ``result.toml`` go to
    the lab's folder.

    Parameters
    ----------
    name : str
        Key of ``EXPERIMENTS``, or a former name of one.
    lab : Lab

    Returns
    -------
    Result

    Raises
    ------
    Refused
        No such experiment, a model that it makes nothing of, or the machine lacks what it needs.
    """
    experiment = experiment_named(name)
    now = experiment.name
    if now != name:
        lab.say(f"{name} is called {now} now")
    if lab.model is not None:
        experiment.check_model()
    module, function = experiment.function.split(":")
    make: Callable[[Lab], Result] = getattr(
        importlib.import_module(f"zendsp.experiment.{module}"), function
    )
    began = time.monotonic()
    result = make(lab)
    lab.say(f"{now}: done in {time.monotonic() - began:.1f} s")
    result.save(lab.folder / now / "result.toml")
    forget_early(lab.folder / now)
    return result
