"""Checks a reference against what a machine may do, before anything is saved or moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zendsp.errors import ReferenceError_
from zendsp.reference.core import Array, Reference


def _per_joint(value: object) -> Array:
    x = np.atleast_1d(np.array(value, dtype=np.float64))
    x.setflags(write=False)
    return x


@dataclass(frozen=True, eq=False)
class Limits:
    """What each joint may do; +inf where there is no limit.

    Parameters
    ----------
    position_min, position_max : array_like, shape (joints,)
        rad (m where a joint slides).
    speed, acceleration, torque : array_like, shape (joints,)
        Largest magnitudes: rad/s, rad/s^2, N m (m/s, m/s^2, N).

    Examples
    --------
    >>> limits = Limits([-1.0], [1.0], [2.0], [10.0], [5.0])
    >>> float(limits.speed[0])
    2.0
    """

    position_min: Array
    position_max: Array
    speed: Array
    acceleration: Array
    torque: Array

    def __post_init__(self) -> None:
        for name in ("position_min", "position_max", "speed", "acceleration", "torque"):
            object.__setattr__(self, name, _per_joint(getattr(self, name)))
        sizes = {
            len(getattr(self, name))
            for name in ("position_min", "position_max", "speed", "acceleration", "torque")
        }
        if len(sizes) != 1:
            raise ReferenceError_(
                f"limits: lists of {sorted(sizes)} joints; every limit needs one value per joint"
            )

    def scaled(self, share: float) -> Limits:
        """Return limits of which speed, acceleration and torque are a share of these; positions
        stay.

        Examples
        --------
        >>> float(Limits([-1.0], [1.0], [2.0], [10.0], [5.0]).scaled(0.5).torque[0])
        2.5
        """
        return Limits(
            self.position_min, self.position_max, share * self.speed, share * self.acceleration,
            share * self.torque,
        )

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.speed)


@dataclass(frozen=True)
class Violation:
    """The worst sample at which one joint breaks one limit.

    Attributes
    ----------
    quantity : {"position", "speed", "acceleration", "torque"}
    joint : int
        From 1.
    t : float, s
    value, limit : float
        In ``unit``.
    unit : str
    headroom : float
        Share of the machine's limit that ``limit`` is.
    """

    quantity: str
    joint: int
    t: float
    value: float
    limit: float
    unit: str
    headroom: float = 1.0

    def __str__(self) -> str:
        return (
            f"joint {self.joint}: {self.quantity} {self.value:.4g} {self.unit} at t = {self.t:.3f}"
            f" s, limit {self.limit:.4g} {self.unit}{self._share()}"
        )

    def _share(self) -> str:
        if self.headroom == 1.0 or self.quantity == "position":
            return ""
        return (
            f" ({100 * self.headroom:g} % of {self.limit / self.headroom:.4g}: headroom"
            f" {self.headroom:g})"
        )


# A limit that is met exactly, as a trapezoid does at its cruise speed, must not fail by the last
# bit of a sum.
ROUNDING = 1e-9
OF_A_PATH = "slow it down, make it smaller, move its centre"
TO_CHANGE = {"swing": "take a lower torque_limit or a nearer goal"}  # by kind of reference
MAY_JUMP = ("step", "user", "from_file")  # kinds whose position is meant to, or may be


def _worst(
    quantity: str, unit: str, x: Array, low: Array, high: Array, t: Array
) -> list[Violation]:
    found = []
    for joint in range(x.shape[1]):
        slack = ROUNDING * max(
            1.0, *(abs(v) for v in (low[joint], high[joint]) if np.isfinite(v)), 1.0
        )
        above, below = x[:, joint] - high[joint], low[joint] - x[:, joint]
        row = int(np.argmax(np.maximum(above, below)))
        if max(above[row], below[row]) > slack:
            limit = high[joint] if above[row] > below[row] else low[joint]
            found.append(
                Violation(
                    quantity, joint + 1, float(t[row]), float(x[row, joint]), float(limit), unit
                )
            )
    return found


def _speed(reference: Reference) -> Array:
    """The speed of every row; of a motion that stands in its rows and moves between them, since
    they are too far apart for it, the mean speed since the row before: it moves as fast somewhere.
    """
    if not reference.jumps or reference.kind in MAY_JUMP:
        return reference.qd
    return np.diff(reference.q, axis=0, prepend=reference.q[:1]) / reference.sample_time


def find_violations(
    reference: Reference, limits: Limits, tau: Array | None = None
) -> list[Violation]:
    """Every limit that a reference breaks, at its worst sample.

    Parameters
    ----------
    reference : Reference
        The motion.
    limits : Limits
        What the machine may do, same number of joints.
    tau : ndarray, shape (N, joints), optional
        Torque that the motion needs, N m; the reference's own tau where not given.

    Returns
    -------
    list of Violation
        Empty when the reference may be played.

    Raises
    ------
    ReferenceError_
        The numbers of joints differ.

    Examples
    --------
    >>> import numpy as np
    >>> limits = Limits([-1.0], [1.0], [2.0], [100.0], [5.0])
    >>> print(find_violations(Reference(np.linspace(0.0, 1.5, 16), 0.1), limits)[0])
    joint 1: position 1.5 rad at t = 1.500 s, limit 1 rad
    """
    if reference.joints != limits.joints:
        raise ReferenceError_(
            f"reference has {reference.joints} joint(s), the machine {limits.joints}: choose the"
            " machine it was planned for"
        )
    torque = reference.tau if tau is None else tau
    u, t = reference.unit, reference.t
    found = _worst("position", u, reference.q, limits.position_min, limits.position_max, t)
    found += _worst("speed", f"{u}/s", _speed(reference), -limits.speed, limits.speed, t)
    found += _worst(
        "acceleration", f"{u}/s^2", reference.qdd, -limits.acceleration, limits.acceleration, t
    )
    if torque is not None:
        found += _worst(
            "torque", "N m" if u == "rad" else "N", torque, -limits.torque, limits.torque, t
        )
    return found


def raise_violations(found: Sequence[Violation], machine: str, kind: str = "") -> None:
    """Turn violations into one error whose message has a line for each.

    Parameters
    ----------
    found : sequence of Violation
        From `find_violations`.
    machine : str
        Named in the message.
    kind : str
        Of the reference: what to change in it.

    Raises
    ------
    ReferenceError_
        There is at least one violation.

    Examples
    --------
    >>> raise_violations([], "imi_planar")
    """
    if found:
        lines = "\n".join(f"  {violation}" for violation in found)
        raise ReferenceError_(
            f"reference breaks {len(found)} limit(s) of {machine}:\n{lines}\n"
            f"  {TO_CHANGE.get(kind, OF_A_PATH)}, or use more of the limits (headroom up to 1)"
        )
