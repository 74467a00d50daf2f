"""Multisine with low crest factor: every joint its own lines of the spectrum, so that joints can be
told apart.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Reference
from zendsp.reference.crest import crest_factor, low_crest_phases
from zendsp.reference.kind import Kind, Parameter, spread
from zendsp.reference.kinds.signal import QUANTITY, START, Quantity, make_signal
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import fade

Spectrum = Literal["flat", "velocity", "acceleration"]
# amplitude of line k is 1/k^power: flat in that derivative
POWER = {"flat": 0, "velocity": 1, "acceleration": 2}


def make_multisine(
    machine: Machine,
    *,
    quantity: Quantity = "position",
    start: npt.ArrayLike,
    amplitude: npt.ArrayLike,
    period: float = 10.0,
    f_min: float = 0.1,
    f_max: float = 2.0,
    periods: int = 2,
    spectrum: Spectrum = "velocity",
    fade_time: float = 0.5,
    sample_time: float | None = None,
) -> Reference:
    """Sum of cosines at multiples of 1/period, dealt out to the joints in turn.

    x_j = a_j Σ_k k^-p cos(2 π k t / period + φ_k), scaled so that its peak is ``amplitude``; joint
    j has the lines k_min + j, k_min + j + joints, … so that no two joints share one.

    Parameters
    ----------
    machine : Machine
        All of whose joints move.
    quantity : {"position", "torque"}
        What swings.
    start : array_like, shape () or (joints,)
        rad.
    amplitude : array_like, shape () or (joints,)
        Peak of each joint, rad or N m; 0 keeps a joint still.
    period : float
        s; 1/period is the spacing of the lines, Hz.
    f_min, f_max : float
        Band, Hz.
    periods : int
        Repetitions.
    spectrum : {"flat", "velocity", "acceleration"}
        Flat in position, in velocity (amplitude 1/k) or in acceleration (1/k^2).
    fade_time : float
        Window at both ends, s: the motion begins and ends at rest.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "multisine"; ``parameters["crest"]`` is the crest factor of one period of each joint.

    Raises
    ------
    ReferenceError_
        The band holds fewer lines than there are joints to move, or reaches half the sampling rate.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_multisine(load_machine("imi_planar"), start=0.0, amplitude=0.3)
    >>> ref.duration, max(ref.parameters["crest"]) < 2.0
    (20.0, True)
    """
    dt = sample_time or machine.sample_time
    peak = spread(machine, "amplitude", amplitude)
    samples = max(2, round(period / dt))
    k_min = max(1, int(np.ceil(f_min * samples * dt - 1e-9)))
    k_max = int(np.floor(f_max * samples * dt + 1e-9))
    moving = np.flatnonzero(peak)
    if k_max - k_min + 1 < max(1, len(moving)) or k_max >= samples // 2:
        raise ReferenceError_(
            f"the band {f_min:g} … {f_max:g} Hz holds {max(0, k_max - k_min + 1)} multiples of"
            f" 1/{period:g} Hz for {len(moving)} joint(s) below {0.5 / dt:g} Hz: lengthen the"
            " period, widen or lower the band"
        )
    t = np.arange(samples * periods + 1, dtype=np.float64) * dt
    w, wd, wdd = fade(t, float(t[-1]), fade_time)
    x, xd, xdd = (np.zeros((len(t), machine.joints)) for _ in range(3))
    crest = [0.0] * machine.joints
    for turn, j in enumerate(moving):
        lines = np.arange(k_min + turn, k_max + 1, len(moving), dtype=np.int64)
        a = lines.astype(np.float64) ** -float(POWER[spectrum])
        angle = 2 * np.pi * np.outer(t, lines) / (samples * dt) + low_crest_phases(lines, a)
        omega = 2 * np.pi * lines / (samples * dt)
        p, v, c = np.cos(angle) @ a, -np.sin(angle) @ (a * omega), -np.cos(angle) @ (a * omega**2)
        crest[j] = crest_factor(p[:samples])
        scale = peak[j] / np.max(np.abs(p))
        x[:, j] = scale * w * p
        xd[:, j] = scale * (wd * p + w * v)
        xdd[:, j] = scale * (wdd * p + 2 * wd * v + w * c)
    used = {
        "amplitude": peak.tolist(), "period": period, "f_min": f_min, "f_max": f_max,
        "periods": periods, "spectrum": spectrum, "fade_time": fade_time, "crest": crest,
    }
    return make_signal(machine, "multisine", quantity, start, (x, xd, xdd), dt, used)


KIND = Kind(
    "multisine",
    "Multisine",
    "Many sines with low crest factor, every joint with lines of its own: excites friction and"
    " inertia together.",
    (
        QUANTITY,
        START,
        Parameter(
            "amplitude",
            "joints",
            "rad or N m",
            0.3,
            "Peak of each joint; 0 keeps one still.",
            0.0,
            1e6,
            by_machine={"wam7": [0.2, 0.15, 0.2, 0.2, 0.3, 0.3, 0.25]},
            keeps="swing",
            fastest=2 * np.pi * 2.0,  # f_max
        ),
        Parameter(
            "period", "float", "s", 10.0, "Period; its inverse is the spacing of the lines.", 0.05,
            3600.0,
        ),
        Parameter("f_min", "float", "Hz", 0.1, "Lowest frequency.", 1e-4, 1e5),
        Parameter("f_max", "float", "Hz", 2.0, "Highest frequency.", 1e-4, 1e5),
        Parameter("periods", "int", "", 2, "Repetitions.", 1, 10000),
        Parameter(
            "spectrum", "choice", "", "velocity", "In which quantity the lines are equal.",
            choices=("flat", "velocity", "acceleration"),
        ),
        Parameter("fade_time", "float", "s", 0.5, "Fade at each end.", 0.0, 600.0),
    ),
    make_multisine,
)
