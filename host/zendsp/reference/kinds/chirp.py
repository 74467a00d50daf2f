"""Chirp: a sine whose frequency rises, linearly or by equal ratios in equal times."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Array, Reference
from zendsp.reference.kind import Kind, Parameter, on_joints
from zendsp.reference.kinds.signal import QUANTITY, START, Quantity, make_signal
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import fade, make_grid

Sweep = Literal["linear", "logarithmic"]


def _phase(
    t: Array, f0: float, f1: float, duration: float, sweep: Sweep
) -> tuple[Array, Array, Array]:
    """Phase and its two derivatives: rad, rad/s, rad/s^2."""
    if sweep == "linear":
        rate = (f1 - f0) / duration
        return (
            2 * np.pi * (f0 * t + 0.5 * rate * t**2),
            2 * np.pi * (f0 + rate * t),
            np.full_like(t, 2 * np.pi * rate),
        )
    if sweep != "logarithmic":
        raise ReferenceError_(f'sweep is "{sweep}"; expected "linear" or "logarithmic"')
    growth = np.log(f1 / f0) / duration
    if abs(growth) < 1e-9:
        return _phase(t, f0, f0, duration, "linear")
    f = f0 * np.exp(growth * t)
    return 2 * np.pi * (f - f0) / growth, 2 * np.pi * f, 2 * np.pi * f * growth


def make_chirp(
    machine: Machine,
    *,
    quantity: Quantity = "position",
    joint: int = 1,
    start: npt.ArrayLike,
    amplitude: float,
    f0: float = 0.1,
    f1: float = 2.0,
    duration: float = 10.0,
    sweep: Sweep = "linear",
    fade_time: float = 0.5,
    sample_time: float | None = None,
) -> Reference:
    """amplitude · window(t) · sin(phase(t)), frequency from f0 to f1.

    Parameters
    ----------
    machine : Machine
        Whose joint moves.
    quantity : {"position", "torque"}
        What swings.
    joint : int
        1-based; 0 for all.
    start : array_like, shape () or (joints,)
        rad.
    amplitude : float
        rad or N m.
    f0, f1 : float
        First and last frequency, Hz.
    duration : float
        s.
    sweep : {"linear", "logarithmic"}
        How the frequency rises.
    fade_time : float
        Rise of the window at the start and its fall at the end, s: the motion begins and ends at
        rest.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "chirp".

    Raises
    ------
    ReferenceError_
        A frequency at or beyond half the sampling rate.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_chirp(load_machine("pendulum"), start=0.0, amplitude=0.2)
    >>> bool(abs(ref.q).max() <= 0.2), float(ref.qd[0, 0])
    (True, 0.0)
    """
    dt = sample_time or machine.sample_time
    for name, f in (("f0", f0), ("f1", f1)):
        if not 0.0 < f < 0.5 / dt:
            raise ReferenceError_(
                f"{name} is {f:g} Hz; it must lie between 0 and half the sampling rate,"
                f" {0.5 / dt:g} Hz"
            )
    t = make_grid(duration, dt)
    w, wd, wdd = fade(t, duration, fade_time)
    p, pd, pdd = _phase(t, f0, f1, duration, sweep)
    s, c = np.sin(p), np.cos(p)
    x = amplitude * w * s
    xd = amplitude * (wd * s + w * c * pd)
    xdd = amplitude * (wdd * s + 2 * wd * c * pd + w * (c * pdd - s * pd**2))
    x, xd, xdd = (on_joints(machine, joint, each) for each in (x, xd, xdd))
    used = {
        "joint": joint, "amplitude": amplitude, "f0": f0, "f1": f1, "duration": duration,
        "sweep": sweep, "fade_time": fade_time,
    }
    return make_signal(machine, "chirp", quantity, start, (x, xd, xdd), dt, used)


KIND = Kind(
    "chirp",
    "Chirp",
    "A sine whose frequency rises from f0 to f1.",
    (
        QUANTITY,
        Parameter("joint", "int", "", 1, "Joint that moves; 0: all.", 0, 64),
        START,
        Parameter(
            "amplitude", "float", "rad or N m", 0.2, "Amplitude.", 0.0,
            by_machine={"wam7": 0.04}, keeps="swing", fastest=2 * np.pi * 2.0,  # f1
        ),
        Parameter("f0", "float", "Hz", 0.1, "First frequency.", 1e-4, 1e5),
        Parameter("f1", "float", "Hz", 2.0, "Last frequency.", 1e-4, 1e5),
        Parameter("duration", "float", "s", 10.0, "Duration.", 0.01, 3600.0),
        Parameter(
            "sweep", "choice", "", "linear", "How the frequency rises.",
            choices=("linear", "logarithmic"),
        ),
        Parameter("fade_time", "float", "s", 0.5, "Fade at each end.", 0.0, 600.0),
    ),
    make_chirp,
)
