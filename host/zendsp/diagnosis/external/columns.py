"""The input of a black-box simulator."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypedDict

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Parameters = Mapping[str, float | list[float]]  # of the mechanism: one number, or one per joint


class Columns(TypedDict):
    """A recording as input of a simulator; arrays are (n,), or (n, joints) for several joints."""

    time: Array  # s, from 0
    sample_time: float  # s
    position: Array
    velocity: Array
    command: Array
    reference: Array | None
