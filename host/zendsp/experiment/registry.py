"""All experiments by name, in the order in which they build on one another."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass

from zendsp.errors import Refused
from zendsp.experiment.lab import Lab
from zendsp.experiment.result import Result


@dataclass(frozen=True)
class Experiment:
    """One experiment of the list.

    Attributes
    ----------
    name : str
    machine : str
        That it is for; empty: any whose command is ``command``.
    title : str
        One line for people.
    function : str
        Where it is: "module:function".
    models : bool
        Whether its result has something that a model file holds.
    command : {"torque", "voltage"}
    """

    name: str
    machine: str
    title: str
    function: str
    models: bool = False
    command: str = "torque"

    def fits(self, machine: str) -> bool:
        """Whether it is for this machine. The kind of command is checked when it begins."""
        return self.machine in ("", machine)

    def run(self, lab: Lab) -> Result:
        """Run it and return its result. Recordings, figure and ``result.toml`` go to the lab's
        folder.
        """
        module, name = self.function.split(":")
        make: Callable[[Lab], Result] = getattr(
            importlib.import_module(f"zendsp.experiment.{module}"), name
        )
        began = time.monotonic()
        result = make(lab)
        lab.say(f"{self.name}: done in {time.monotonic() - began:.1f} s")
        result.save(lab.folder / self.name / "result.toml")
        return result


EXPERIMENTS = {
    e.name: e
    for e in (
        Experiment(
            "friction", "",
            "Friction of every joint that takes a torque: constant speeds both ways.",
            "any_friction:friction", models=True,
        ),
        Experiment(
            "imi-static", "imi_planar",
            "Static friction: torque steps both ways from several positions.",
            "imi_breakaway:static",
        ),
        Experiment(
            "imi-viscous", "imi_planar", "Friction at high speed: constant torque, open loop.",
            "imi_friction:viscous",
        ),
        Experiment(
            "imi-low-speed", "imi_planar",
            "Friction at low speed: triangular velocity under PD, averaged.",
            "imi_friction:low_speed",
        ),
        Experiment(
            "imi-fit", "imi_planar", "One friction curve of two polynomials through the three.",
            "imi_fit:fit", models=True,
        ),
        Experiment(
            "imi-circle", "imi_planar",
            "Circle under inverse dynamics, compensated or not, machine and simulation.",
            "imi_circle:circle",
        ),
        Experiment(
            "pendulum-electrical", "pendulum", "k_a and R_a of the motor by the straight line.",
            "pendulum_motor:electrical", command="voltage",
        ),
        Experiment(
            "pendulum-mechanical", "pendulum",
            "Inertia, gravity and friction from the open-loop torque law.",
            "pendulum_motor:mechanical", models=True,
        ),
        Experiment(
            "pendulum-swing", "pendulum",
            "Optimal swing open and closed loop, and friction at the feedback level.",
            "pendulum_swing:swing",
        ),
        Experiment(
            "wam-friction", "wam7", "Friction maps of seven joints with confidence intervals.",
            "wam_friction:friction", models=True,
        ),
        Experiment(
            "wam-tracking", "wam7",
            "Joint error of machine and simulation, each joint alone and all together.",
            "wam_tracking:tracking",
        ),
    )
}


def run_experiment(name: str, lab: Lab) -> Result:
    """Run an experiment by name and return its result.

    Parameters
    ----------
    name : str
        Key of ``EXPERIMENTS``.
    lab : Lab

    Returns
    -------
    Result

    Raises
    ------
    Refused
        No such experiment.
    """
    if name not in EXPERIMENTS:
        raise Refused(f"no experiment {name!r}; there are {', '.join(EXPERIMENTS)}")
    return EXPERIMENTS[name].run(lab)
