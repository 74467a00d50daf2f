"""What step, chirp, multisine and PRBS share: a test signal as a position to follow or a torque to
play.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy.typing as npt

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Array, Reference
from zendsp.reference.dynamics import predict_motion
from zendsp.reference.kind import Parameter, spread
from zendsp.reference.machine import Machine

Quantity = Literal["position", "torque"]

START = Parameter(
    "start",
    "joints",
    "rad",
    None,
    "Middle (position) or start (torque) of every joint.",
    by_machine={"wam7": [0.0, 0.5, 0.0, 1.5, -1.5, 0.0, 0.0]},
)
QUANTITY = Parameter(
    "quantity",
    "choice",
    "",
    "position",
    "A position to follow, or a torque to play open loop.",
    choices=("position", "torque"),
)


def make_signal(
    machine: Machine,
    kind: str,
    quantity: Quantity,
    start: npt.ArrayLike,
    signal: tuple[Array, Array, Array],
    sample_time: float,
    parameters: Mapping[str, Any],
) -> Reference:
    """A signal and its derivatives as a reference: added to ``start``, or as torque with the motion
    it should cause.

    Parameters
    ----------
    machine : Machine
        Its nominal model predicts the motion of a torque.
    kind : str
        Name of the generator.
    quantity : {"position", "torque"}
        What the signal is.
    start : array_like, shape () or (joints,)
        rad.
    signal : tuple of ndarray, shape (N, joints)
        Value and two derivatives; rad or N m.
    sample_time : float
        s.
    parameters : mapping
        Stored with the reference.

    Returns
    -------
    Reference
        Mode "position" or "torque".

    Examples
    --------
    >>> import numpy as np
    >>> from zendsp.reference import load_machine
    >>> zero = np.zeros((5, 1))
    >>> make_signal(load_machine("pendulum"), "none", "torque", 0.0, (zero, zero, zero), 0.001, {}).mode
    'torque'
    """  # noqa: E501
    base = spread(machine, "start", start)
    used = {**parameters, "quantity": quantity, "start": base.tolist()}
    x, xd, xdd = signal
    if quantity == "position":
        return Reference(
            base + x, sample_time, xd, xdd, kind=kind, parameters=used, machine=machine.name
        )
    if quantity != "torque":
        raise ReferenceError_(f'quantity is "{quantity}"; expected "position" or "torque"')
    if machine.kind in ("dh", "tree"):
        raise ReferenceError_(
            f"an open-loop torque lets {machine.name} fall under its own weight: plan a position"
            " instead"
        )
    q, qd, qdd = predict_motion(machine.dynamics, x, sample_time, base)
    return Reference(
        q, sample_time, qd, qdd, x, kind=kind, parameters=used, machine=machine.name, mode="torque"
    )
