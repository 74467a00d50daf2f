"""What a simulator that can only be called is given."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypedDict

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Parameters = Mapping[str, float | list[float]]  # of the mechanism: one number, or one a joint


class Columns(TypedDict):
    """A recording as a simulator gets it; arrays are (n,), or (n, joints) of several joints."""

    time: Array  # s, from 0
    sample_time: float  # s
    position: Array
    velocity: Array
    command: Array
    reference: Array | None
