"""Runs an experiment of the list by its name."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable

from zendsp.errors import Refused
from zendsp.experiment.lab import Lab
from zendsp.experiment.names import present_name
from zendsp.experiment.registry import EXPERIMENTS
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
        No such experiment, or the machine lacks what it needs.
    """
    now = present_name(name)
    if now not in EXPERIMENTS:
        raise Refused(f"no experiment {name!r}; there are {', '.join(EXPERIMENTS)}")
    if now != name:
        lab.say(f"{name} is called {now} now")
    module, function = EXPERIMENTS[now].function.split(":")
    make: Callable[[Lab], Result] = getattr(
        importlib.import_module(f"zendsp.experiment.{module}"), function
    )
    began = time.monotonic()
    result = make(lab)
    lab.say(f"{now}: done in {time.monotonic() - began:.1f} s")
    result.save(lab.folder / now / "result.toml")
    return result
