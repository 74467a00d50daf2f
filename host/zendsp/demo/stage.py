"""The machines of the story: nominal model, gains, and the motions that are recorded and followed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from zendsp.demo import motions
from zendsp.errors import Refused
from zendsp.physics.files.model_file import parse_model
from zendsp.physics.model import MechanismTable, Model
from zendsp.reference import Machine, Reference, load_machine

DELAY_SAMPLES = 1  # what the code writes at sample k acts from sample k + 1 (isr.h)


@dataclass(frozen=True)
class Stage:
    """A machine of the story.

    Attributes
    ----------
    machine : str
        Name of the simulated machine.
    Kp, Kd : tuple of float
        Gains of the joints, N m/rad and N m s/rad.
    cutoff : float
        Of the velocity filter, Hz.
    train, heldout, work : callable
        Make the motion that is recorded for the diagnosis, the one it is judged on, and one lap of
        the work that is repeated.
    mechanism : callable
        The ``[mechanism]`` of the nominal model from the machine's description; what files it needs
        it writes into the folder.
    pool : tuple of str
        Effects that a random draw may choose.
    approach_s : float
        From where the machine stands to the first row of a motion, s.
    besides : mapping of str to str
        Effects that the machine has, besides what it conceals, and its nominal model has not: why.
    """

    machine: str
    Kp: tuple[float, ...]
    Kd: tuple[float, ...]
    cutoff: float
    train: Callable[[Machine], Reference]
    heldout: Callable[[Machine], Reference]
    work: Callable[[Machine], Reference]
    mechanism: Callable[[Machine, Path], MechanismTable]
    pool: tuple[str, ...]
    approach_s: float = 1.0
    besides: Mapping[str, str] = field(default_factory=dict)

    @property
    def plan(self) -> Machine:
        """Limits and nominal numbers."""
        return load_machine(self.machine)


def nominal_model(
    stage: Stage,
    counts_per_unit: tuple[float, ...],
    sample_time: float,
    folder: Path = Path(),
) -> Model:
    """The model that the host believes: rigid body, viscous and Coulomb friction, the sensor's
    resolution, one sample of delay.

    Parameters
    ----------
    counts_per_unit : tuple of float
        Of the encoders, as the target states them, 1/rad.
    sample_time : float
        s.
    folder : Path
        For the description of the bodies, where the model has one.
    """
    plan = stage.plan
    effects: list[Mapping[str, object]] = []
    for j, (viscous, level) in enumerate(_friction(plan), start=1):
        effects.append(
            {"kind": "viscous", "joint": j, "coefficient": {"value": viscous, "unit": "N m s/rad"}}
        )
        effects.append({"kind": "coulomb", "joint": j, "level": {"value": level, "unit": "N m"}})
    resolution = [1.0 / counts for counts in counts_per_unit]
    return parse_model(
        {
            "name": stage.machine,
            "sample_time": sample_time,
            "mechanism": stage.mechanism(plan, folder),
            "effect": effects,
            "actuator": {
                "gain": {"value": 1.0, "free": False},
                "limit": plan.limits.torque.tolist(),
                "hold": sample_time,
                "delay": DELAY_SAMPLES * sample_time + plan.parameters.get("current_loop", 0.0),
            },
            "sensor": {"position_resolution": resolution if len(resolution) > 1 else resolution[0]},
            "columns": {"time": "t", "position": "q", "command": "tau", "reference": "r"},
        }
    )


def _friction(plan: Machine) -> list[tuple[float, float]]:
    numbers = plan.parameters
    levels = numbers["coulomb"] if "coulomb" in numbers else [numbers["theta3"]]
    return list(zip(np.ravel(numbers["viscous"]).tolist(), np.ravel(levels).tolist(), strict=True))


STAGES = {
    "imi_planar": Stage(
        machine="imi_planar", Kp=(2000.0, 300.0), Kd=(120.0, 12.0), cutoff=40.0,
        train=motions.arm_train, heldout=motions.arm_heldout, work=motions.arm_work,
        mechanism=motions.arm_mechanism, pool=motions.ARM_POOL,
    ),
    "pendulum": Stage(
        machine="pendulum", Kp=(4.0,), Kd=(0.06,), cutoff=30.0, train=motions.pendulum_train,
        heldout=motions.pendulum_heldout, work=motions.pendulum_work,
        mechanism=motions.pendulum_mechanism, pool=motions.PENDULUM_POOL,
        besides=dict.fromkeys(("saturation", "voltage_limit"), "its supply gives 24 V, no more"),
    ),
    "wam7": Stage(
        machine="wam7",
        Kp=(900.0, 1200.0, 300.0, 200.0, 25.0, 25.0, 6.0),
        Kd=(40.0, 50.0, 8.0, 6.0, 0.3, 0.3, 0.02),
        cutoff=80.0,
        train=motions.wam_train,
        heldout=motions.wam_heldout,
        work=motions.wam_work,
        mechanism=motions.wam_mechanism,
        pool=motions.WAM_POOL,
        approach_s=3.0,  # from folded
    ),
}


def get_stage(machine: str) -> Stage:
    """The stage of a machine.

    Parameters
    ----------
    machine : str
        Name of the simulated machine.

    Returns
    -------
    Stage

    Raises
    ------
    Refused
        The story is not told with this machine.
    """
    if machine not in STAGES:
        raise Refused(
            f"the demo has no story for the machine {machine!r}; choose one of {', '.join(STAGES)}"
        )
    return STAGES[machine]
