"""The pendulum paper's open-loop torque, from which its mechanical parameters are estimated."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from zendsp.reference.core import Reference
from zendsp.reference.kind import Kind, Parameter, on_joints
from zendsp.reference.kinds.signal import START, make_signal
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import make_grid


def make_torque_law(
    machine: Machine,
    *,
    joint: int = 1,
    start: npt.ArrayLike = 0.0,
    level: float = 0.3,
    rate: float = 1.8,
    a1: float = 0.1,
    w1: float = 26.0,
    phi1: float = 0.08,
    a2: float = 0.1,
    w2: float = 12.0,
    phi2: float = 0.34,
    duration: float = 5.0,
    sample_time: float | None = None,
) -> Reference:
    """tau(t) = level (1 - exp(-rate t)) + a1 sin(w1 t + phi1) + a2 sin(w2 t + phi2) (Hardware 2025,
    3(3), 11).

    Parameters
    ----------
    machine : Machine
        Whose joint is driven.
    joint : int
        1-based.
    start : array_like, shape () or (joints,)
        rad.
    level, a1, a2 : float
        N m.
    rate : float
        1/s.
    w1, w2 : float
        rad/s.
    phi1, phi2 : float
        rad.
    duration : float
        s.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "torque_law", mode "torque", with the motion that the nominal model predicts.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_torque_law(load_machine("pendulum"), duration=1.0)
    >>> round(float(ref.tau[0, 0]), 4)
    0.0413
    """
    dt = sample_time or machine.sample_time
    t = make_grid(duration, dt)
    tau = level * (1 - np.exp(-rate * t)) + a1 * np.sin(w1 * t + phi1) + a2 * np.sin(w2 * t + phi2)
    x = on_joints(machine, joint, tau)
    used = {
        "joint": joint, "level": level, "rate": rate, "a1": a1, "w1": w1, "phi1": phi1, "a2": a2,
        "w2": w2, "phi2": phi2, "duration": duration,
    }
    return make_signal(machine, "torque_law", "torque", start, (x, x, x), dt, used)


KIND = Kind(
    "torque_law",
    "Torque law of the pendulum paper",
    "A rising torque with two sines, played open loop.",
    (
        Parameter("joint", "int", "", 1, "Joint that is driven.", 1, 64),
        START,
        Parameter("level", "float", "N m", 0.3, "Torque that the exponential rises to."),
        Parameter("rate", "float", "1/s", 1.8, "Rate of the exponential.", 0.0, 1000.0),
        Parameter("a1", "float", "N m", 0.1, "Amplitude of the first sine."),
        Parameter("w1", "float", "rad/s", 26.0, "Frequency of the first sine.", 0.0, 3000.0),
        Parameter("phi1", "float", "rad", 0.08, "Phase of the first sine."),
        Parameter("a2", "float", "N m", 0.1, "Amplitude of the second sine."),
        Parameter("w2", "float", "rad/s", 12.0, "Frequency of the second sine.", 0.0, 3000.0),
        Parameter("phi2", "float", "rad", 0.34, "Phase of the second sine."),
        Parameter("duration", "float", "s", 5.0, "Duration.", 0.01, 3600.0),
    ),
    make_torque_law,
    machine_kinds=("pendulum", "planar2r"),
)
