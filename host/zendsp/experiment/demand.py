"""What a planned motion takes of a joint's drive, by what a gentle motion before it has shown; and
the motion made slower where that is more than the drive has.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.errors import Unmeasured
from zendsp.experiment.estimates import NORMAL
from zendsp.experiment.joints import USED
from zendsp.experiment.sliding import Sliding
from zendsp.reference import Reference
from zendsp_protocol.messages import JointInfo

Array = npt.NDArray[np.float64]

KNOWN = 0.2  # of an inertia, its standard deviation at most where loop and plan go by it
SLOWEST = 0.1  # of its usual speeds: a motion that takes ten times as long is refused
HALVINGS = 20  # of an interval that holds how slow a motion has to be


@dataclass(frozen=True)
class Felt:
    """What a gentle motion shows of a joint, the two directions of friction alike.

    Attributes
    ----------
    inertia : float
        kg m^2 or kg; 0 where the motion does not tell it.
    middle : float
        About which it moved, rad or m.
    x : ndarray
        Torque by acceleration, direction, speed, the same everywhere, and the way off the middle.
    covariance : ndarray
        Of these.
    noise : float
        Standard deviation of what the loop adds from sample to sample.
    """

    inertia: float
    middle: float
    x: Array
    covariance: Array
    noise: float = 0.0

    def takes(self, reference: Reference, joint: int) -> tuple[float, float]:
        """The largest torque that a planned motion may take, as 95 % intervals bound it, and what
        friction and weight take of that at rest.

        What acceleration and speed take counts ``1 / USED`` times: that is left to the loop. The
        weight of a joint that turns is continued in a straight line. As it curves towards zero, it
        is less than that.
        """
        q, qd, qdd = (x[:, joint - 1] for x in (reference.q, reference.qd, reference.qdd))
        moves = np.abs(qd) > 0.0
        q, qd, qdd = q[moves], qd[moves], qdd[moves]
        one, none = np.ones_like(q), np.zeros_like(q)
        rest = self._most(np.stack([none, np.sign(qd), none, one, q - self.middle], axis=1), 1.0)
        moving = self._most(np.stack([qdd, none, qd, none, none], axis=1), 0.0)
        return float((rest + moving / USED).max(initial=0.0)), float(rest.max(initial=0.0))

    def _most(self, rows: Array, share: float) -> Array:
        std = np.sqrt(np.einsum("ij,jk,ik->i", rows, self.covariance, rows))
        return np.asarray(np.abs(rows @ self.x) + NORMAL * np.hypot(std, share * self.noise))


def felt(gentle: Sliding, declared: float, noise: float) -> Felt:
    """What a gentle motion shows of a joint, inertia as ``declared`` where it does not show that.

    A viscous friction, and a weight that changes along the way, count where they are told from
    zero: over a short way nothing bounds what they might be at the end of a longer one.
    """
    middle = float(np.mean([gentle.q.min(), gentle.q.max()]))
    one = np.ones_like(gentle.q)
    A = np.stack(
        [gentle.acceleration, np.sign(gentle.speed), gentle.speed, one, gentle.q - middle], axis=1
    )
    x, covariance = _solved(A, gentle.torque, range(5))
    inertia = float(x[0]) if covariance[0, 0] ** 0.5 < KNOWN * x[0] else 0.0
    torque = gentle.torque if inertia else gentle.torque - declared * gentle.acceleration
    used = [k for k in range(5) if k or inertia]
    for k in (2, 4):
        x, covariance = _solved(A, torque, used)
        if not abs(x[k]) > NORMAL * covariance[k, k] ** 0.5:
            used.remove(k)
    x, covariance = _solved(A, torque, used)
    if not np.isfinite(covariance).all():  # it slid one way only: what it took is friction
        x, covariance = np.zeros(5), np.zeros((5, 5))
        x[1] = float(np.abs(torque).max())
    x[0] = x[0] if inertia else declared
    return Felt(inertia, middle, x, covariance, noise)


def _solved(A: Array, torque: Array, used: Sequence[int]) -> tuple[Array, Array]:
    """Solution and covariance by the columns that are used; infinite where it has none."""
    x, covariance = np.zeros(A.shape[1]), np.zeros((A.shape[1], A.shape[1]))
    B = A[:, list(used)]
    free = len(B) - B.shape[1]
    if free < 1 or np.linalg.matrix_rank(B) < B.shape[1]:
        return x, np.full_like(covariance, np.inf)
    x[list(used)] = y = np.linalg.lstsq(B, torque, rcond=None)[0]
    variance = float(np.sum((torque - B @ y) ** 2)) / free
    covariance[np.ix_(used, used)] = variance * np.linalg.inv(B.T @ B)
    return x, covariance


def within_drive(
    make: Callable[[float], Reference], known: Felt, own: JointInfo, joint: int
) -> tuple[float, str]:
    """The share of its usual speeds at which a motion takes no more than a joint's drive has, and
    a sentence where that is less than one.

    Parameters
    ----------
    make : callable
        The motion at a share of its speeds; its accelerations go by the square of that.
    known : Felt
    own : JointInfo
    joint : int
        1-based.

    Raises
    ------
    Unmeasured
        Not even ``SLOWEST`` is slow enough.
    """
    usual = make(1.0)
    most, unit = own.torque_max, own.unit
    force = "N m" if unit == "rad" else "N"
    wanted, rest = known.takes(usual, joint)
    if wanted <= most:
        return 1.0, ""
    if known.takes(make(SLOWEST), joint)[0] > most:
        low, high = usual.q[:, joint - 1].min(), usual.q[:, joint - 1].max()
        raise Unmeasured(
            f"joint {joint} ({own.name}): friction and weight take up to {rest:.3g} {force} from"
            f" {low:.3g} to {high:.3g} {unit}, of the {most:.3g} {force} that its drive has"
            f" (torque_max): what is left does not move it even at {SLOWEST:.0%} of the usual"
            " speed. Put it where it weighs less, or let the machine declare a larger torque_max"
            " if the drive bears it"
        )
    share, beyond = SLOWEST, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (share + beyond)
        if known.takes(make(middle), joint)[0] <= most:
            share = middle
        else:
            beyond = middle
    fastest = float(np.abs(usual.qd[:, joint - 1]).max())
    return share, (
        f"Joint {joint} moves at up to {share * fastest:.3g} {unit}/s instead of {fastest:.3g}:"
        f" that might take {wanted:.3g} {force}, with what is left to its loop, and its drive has"
        f" {most:.3g} {force} (torque_max)."
    )
