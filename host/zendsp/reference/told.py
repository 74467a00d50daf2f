"""The machine of a target, as the target tells it."""

from __future__ import annotations

import numpy as np

from zendsp.reference.limits import Limits
from zendsp.reference.machine import MACHINES, Machine, load_machine, make_limited
from zendsp_protocol import messages as m


def shipped(said: m.MachineInfo) -> Machine | None:
    """The shipped description of a target's machine; None where there is none."""
    if said.name not in MACHINES or said.model:
        return None
    machine = load_machine(said.name)
    return machine if len(said.joints) == machine.joints else None


def machine_told(said: m.MachineInfo, limits: m.Limits | None, period: float) -> Machine:
    """The shipped description of a target's machine, else one made of what the target tells.

    Parameters
    ----------
    said : MachineInfo
        With its joints, which a target knows while a program is loaded.
    limits : Limits or None
        That the target checks; None: those that the machine declares.
    period : float
        Of its control loop, s.

    Returns
    -------
    Machine
        Of kind "limits" where none is shipped: no torque is predicted, and no acceleration limited.
    """
    known = shipped(said)
    if known is not None:
        return known
    at = said.joints
    low, high, speed, torque = (
        np.array([getattr(j, key) for j in at] if limits is None else getattr(limits, key))
        for key in ("position_min", "position_max", "speed_max", "torque_max")
    )
    units = {joint.unit for joint in at}
    return make_limited(
        said.name,
        period,
        [joint.home for joint in at],
        Limits(low, high, speed, np.full(len(at), np.inf), torque),
        "rad or m" if len(units) > 1 else units.pop(),
        [joint.unit for joint in at] if len(units) > 1 else (),
    )
