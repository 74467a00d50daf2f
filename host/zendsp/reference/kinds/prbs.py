"""Pseudo-random binary sequence, as a torque to play or as the velocity of a motion to follow."""

from __future__ import annotations

from typing import Literal

import numpy as np
import numpy.typing as npt

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Array, Reference
from zendsp.reference.kind import Kind, Parameter, on_joints
from zendsp.reference.kinds.signal import START, make_signal
from zendsp.reference.machine import Machine
from zendsp.reference.profiles import integrate_velocity, make_grid

# Feedback taps that give sequences of full length 2^n - 1 (primitive polynomials; Golomb, Shift
# Register Sequences).
TAPS = {
    3: (3, 2), 4: (4, 3), 5: (5, 3), 6: (6, 5), 7: (7, 6), 8: (8, 6, 5, 4), 9: (9, 5), 10: (10, 7),
    11: (11, 9), 12: (12, 6, 4, 1),
}


def maximum_length_sequence(order: int) -> Array:
    """±1, of length 2^order - 1, with an autocorrelation of 1 at zero and -1/length elsewhere.

    Parameters
    ----------
    order : int
        3 to 12.

    Returns
    -------
    ndarray, shape (2**order - 1,)
        +1 or -1.

    Raises
    ------
    ReferenceError_
        No such order.

    Examples
    --------
    >>> s = maximum_length_sequence(5)
    >>> len(s), int(s.sum())
    (31, 1)
    """
    if order not in TAPS:
        raise ReferenceError_(f"order is {order}; expected 3 to 12")
    register = [1] * order
    bits = []
    for _ in range(2**order - 1):
        bits.append(register[-1])
        register = [sum(register[tap - 1] for tap in TAPS[order]) % 2, *register[:-1]]
    return 2.0 * np.array(bits) - 1.0


def make_prbs(
    machine: Machine,
    *,
    quantity: Literal["velocity", "torque"] = "velocity",
    joint: int = 1,
    start: npt.ArrayLike,
    amplitude: float,
    order: int = 7,
    clock: float = 0.1,
    ramp: float = 0.02,
    sample_time: float | None = None,
) -> Reference:
    """One period of a maximum-length sequence of ±amplitude, each bit ``clock`` seconds.

    Parameters
    ----------
    machine : Machine
        Whose joint moves.
    quantity : {"velocity", "torque"}
        What is binary: the speed of a motion to follow, or the torque to play.
    joint : int
        1-based; 0 for all.
    start : array_like, shape () or (joints,)
        rad.
    amplitude : float
        rad/s or N m.
    order : int
        Length 2^order - 1 bits.
    clock : float
        Time of a bit, s.
    ramp : float
        Time of a change of velocity, s, at most one bit.
    sample_time : float, optional
        s.

    Returns
    -------
    Reference
        Kind "prbs".

    Raises
    ------
    ReferenceError_
        A bit shorter than a sample, or a ramp longer than a bit.

    Examples
    --------
    >>> from zendsp.reference import load_machine
    >>> ref = make_prbs(load_machine("pendulum"), quantity="torque", start=0.0, amplitude=0.1, order=4, clock=0.05)
    >>> sorted(set(ref.tau[:-1, 0].tolist()))
    [-0.1, 0.1]
    """  # noqa: E501
    dt = sample_time or machine.sample_time
    if clock < dt or (quantity == "velocity" and not 0.0 <= ramp <= clock):
        raise ReferenceError_(
            f"clock is {clock:g} s and ramp {ramp:g} s; expected sample time {dt:g} <= clock and"
            " ramp <= clock"
        )
    clock = round(clock / dt) * dt
    bits = maximum_length_sequence(order)
    used = {"joint": joint, "amplitude": amplitude, "order": order, "clock": clock, "ramp": ramp}
    if quantity == "torque":
        held = np.repeat(bits, round(clock / dt)) * amplitude
        x = on_joints(machine, joint, np.append(held, 0.0))  # ends without torque
        return make_signal(machine, "prbs", "torque", start, (x, x, x), dt, used)
    if quantity != "velocity":
        raise ReferenceError_(f'quantity is "{quantity}"; expected "velocity" or "torque"')
    knots, values = [0.0], [0.0]
    for i, bit in enumerate(bits):
        knots += [i * clock + max(ramp, dt), (i + 1) * clock]
        values += [bit * amplitude, bit * amplitude]
    knots.append(knots[-1] + max(ramp, dt))
    values.append(0.0)
    x, xd, xdd = integrate_velocity(make_grid(knots[-1], dt), knots, values)
    x, xd, xdd = (on_joints(machine, joint, each) for each in (x, xd, xdd))
    moved = make_signal(machine, "prbs", "position", start, (x, xd, xdd), dt, used)
    return Reference(moved.q, dt, moved.qd, moved.qdd, kind="prbs", machine=machine.name,
                     parameters={**moved.parameters, "quantity": "velocity"})  # fmt: skip


KIND = Kind(
    "prbs",
    "PRBS",
    "Pseudo-random binary velocity or torque (maximum-length sequence).",
    (
        Parameter(
            "quantity", "choice", "", "velocity", "What is binary.", choices=("velocity", "torque")
        ),
        Parameter("joint", "int", "", 1, "Joint that moves; 0: all.", 0, 64),
        START,
        Parameter("amplitude", "float", "rad/s or N m", 0.3, "Level, plus and minus.", 0.0),
        Parameter("order", "int", "", 7, "Length of 2^order - 1 bits.", 3, 12),
        Parameter("clock", "float", "s", 0.1, "Time of a bit.", 1e-4, 60.0),
        Parameter(
            "ramp", "float", "s", 0.02, "Time of a change of velocity.", 0.0, 60.0,
            by_machine={"wam7": 0.1},
        ),
    ),
    make_prbs,
)
