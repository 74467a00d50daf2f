"""The smallest push that these recordings would have shown at each joint.

A push is looked for where the missing torque exceeds `LAWFUL`. It is found where most of the
missing torque acts within it (`measure/bursts.py`). So a push of one second needs that RMS torque
over the longest part of the recordings, and has to stand out of all else that is unexplained there.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from zendsp.diagnosis.data.signals import Parts
from zendsp.diagnosis.decide.claims import Decision
from zendsp.diagnosis.decide.result import Detectable
from zendsp.diagnosis.decide.thresholds import LAWFUL
from zendsp.diagnosis.measure.bursts import BURST_SHARE
from zendsp.physics.model import Model

A_PUSH = "disturbance"  # the mechanism, and its name
LASTS = 1.0  # s, the push of which a size is stated
# of a push's RMS torque: the part that is found missing, since the calibrated numbers follow the
# push. Of one second in 6 and in 12: 0.53 and 0.49
STAYS_MISSING = 0.5
# RMS of a push over that of the rest, with which all but BURST_SHARE of the energy is the push's
OUT_OF = math.sqrt((1.0 - BURST_SHARE) / BURST_SHARE)


def detectable_pushes(
    parts: Parts, given: Model, decisions: Sequence[Decision]
) -> tuple[Detectable, ...]:
    """The smallest push of a second that would have been found at each joint, N m or N."""
    out = []
    for d in decisions:
        seconds = max(
            sum(rec[d.joint - 1].n * rec[d.joint - 1].sample_time for rec in part.records)
            for part in parts.each
        )
        needed = max(LAWFUL, OUT_OF * max(d.after.high, d.after.often))
        share = needed / STAYS_MISSING * math.sqrt(seconds / LASTS)
        size = share * d.scale if share <= 1.0 else math.inf
        unit = given.torque_unit(d.joint)
        out.append(Detectable(d.joint, A_PUSH, A_PUSH, size, unit, needed))
    return tuple(out)
