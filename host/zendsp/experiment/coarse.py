"""What a loop bears of its encoders: each count is seen as a speed, and answered with torque."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

import numpy as np
import numpy.typing as npt

from zendsp_protocol.messages import JointInfo

Array = npt.NDArray[np.float64]

USUAL = 80.0  # Hz, of the velocity filter of joint_pd.c
# of the largest torque, that one count may ask for; noise and the next count come on top. Joints
# with 4096 counts a turn asked for half, were at their limit in 4 to 18 % of the samples, and no
# experiment was made (docs/measurements/experiments.md)
KICK = 0.2
ABOVE = 10.0  # times the bandwidth, that the filter leaves alone: 11 degrees at the crossover


def cutoff_for(joints: Sequence[JointInfo], J: Array, bandwidth: float) -> float:
    """Cutoff of the velocity filter of joint_pd.c, Hz: the usual one, or a lower one where a count
    of an encoder asks for too much torque.

    One count is seen as a speed of 2 pi cutoff counts, and answered by 2 J w times that.
    """
    least = ABOVE * bandwidth
    kick = _torque(joints, J, bandwidth) * 2.0 * pi * USUAL
    return float(np.clip(USUAL * KICK / max(float(kick.max(initial=0.0)), 1e-9), least, USUAL))


def widest_bandwidth(joints: Sequence[JointInfo], J: Array) -> float:
    """Bandwidth of joint_pd.c that the encoders bear with the lowest cutoff it may have, Hz."""
    kick = _torque(joints, J, 1.0) * 2.0 * pi * ABOVE  # grows by the square of the bandwidth
    return float((KICK / max(float(kick.max(initial=0.0)), 1e-9)) ** 0.5)


def _torque(joints: Sequence[JointInfo], J: Array, bandwidth: float) -> Array:
    """Torque that a speed of a count a second is answered with, as a share of the largest one."""
    counts = [1.0 / abs(j.counts_per_unit) for j in joints]
    most = [j.torque_max if j.command != "none" else np.inf for j in joints]
    return np.asarray(2.0 * J * 2.0 * pi * bandwidth * np.array(counts) / np.array(most))
