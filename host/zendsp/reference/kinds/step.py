"""Steps: one, or a staircase of equal increments (the torque steps that find static friction)."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.reference.core import Reference
from zendsp.reference.kind import Kind, Parameter, on_joints
from zendsp.reference.kinds.signal import QUANTITY, START, Quantity, make_signal
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import make_grid


def make_step(
    machine: Machine,
    *,
    quantity: Quantity = "position",
    joint: int = 1,
    start: npt.ArrayLike,
    amplitude: float,
    steps: int = 1,
    wait: float = 0.2,
    hold: float = 1.0,
    sample_time: float | None = None,
) -> Reference:
    """``wait`` seconds of nothing, then ``steps`` equal increments that add up to ``amplitude``,
    ``hold`` seconds each.

    The speed and acceleration of a position step are given as zero: what follows it is the loop's
    step response.

    Parameters
    ----------
    machine : Machine
        Whose joint steps.
    quantity : {"position", "torque"}
        What steps.
    joint : int
        1-based; 0 for all.
    start : array_like, shape () or (joints,)
        rad.
    amplitude : float
        Of the whole staircase, rad or N m.
    steps : int
        Number of increments.
    wait, hold : float
        s.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "step".

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_step(load_machine("pendulum"), start=0.0, amplitude=0.4, steps=2, wait=0.1, hold=0.1)
    >>> sorted(set(ref.q[:, 0].round(6).tolist()))
    [0.0, 0.2, 0.4]
    """  # noqa: E501
    dt = sample_time or machine.sample_time
    t = make_grid(wait + steps * hold, dt)
    level = np.clip(np.floor((t - wait) / hold + 1e-9) + 1.0, 0.0, steps) * amplitude / steps
    x = on_joints(machine, joint, level)
    used = {"joint": joint, "amplitude": amplitude, "steps": steps, "wait": wait, "hold": hold}
    return make_signal(machine, "step", quantity, start, (x, 0 * x, 0 * x), dt, used)


KIND = Kind(
    "step",
    "Step or staircase",
    "A step of position or torque, or a staircase of equal increments.",
    (
        QUANTITY,
        Parameter("joint", "int", "", 1, "Joint that steps; 0: all.", 0, 64),
        START,
        Parameter(
            "amplitude", "float", "rad or N m", 0.1, "Height of the whole staircase.",
            keeps="swing",
        ),
        Parameter("steps", "int", "", 1, "Number of equal increments.", 1, 10000),
        Parameter("wait", "float", "s", 0.2, "Rest before the first step.", 0.0, 600.0),
        Parameter("hold", "float", "s", 1.0, "Time at each level.", 1e-3, 600.0),
    ),
    make_step,
)
