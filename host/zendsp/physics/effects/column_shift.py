"""The command column is shifted in time against the position column.

Its rows were written before or after the sample that they belong to. A column that is late holds at
each row what acted before: the command of the future explains the motion, which no machine can. One
that is early is a delay of the actuator by another name, and the delay the likelier of the two.
"""

from __future__ import annotations

import numpy as np

from zendsp.physics.effects.axes import late
from zendsp.physics.effects.base import Along, Array, Effect, Facts, Numbers, Parameter

# of a row: first-order integrators, and commands logged at an instant, are half a row off; at six
# joints this came out as 0.49 to 0.53
ROW = 0.6
# the same with lines between the rows of a faster loop: at 14 joints of four simulated arms with
# logs 3 to 14 ms late, shifts came out as 8 to 20 ms, at most 2.0 rows, 0.6 too much
LINES = 2.1


def least_shift(sample_time: float, lines: bool) -> float:
    """The shift, s, below which a command is late in any recording without every step of the loop.
    """
    return (LINES if lines else ROW) * sample_time


def _early(along: Along, p: Numbers) -> Array:
    return -late(along, p)


def _limits(facts: Facts) -> tuple[float, float]:
    """Limits of a few rows; larger shifts are visible by eye."""
    most = max(0.05, 5 * facts.sample_time)
    return -most, most


def _moved(command: Array, sample_time: float, p: Numbers) -> Array:
    """What acted in each sample, (n,), where the column holds it late."""
    edges = np.arange(len(command) + 1) * sample_time
    total = np.r_[0.0, np.cumsum(command)] * sample_time
    ahead: Array = np.interp(edges + p["time"], edges, total, left=0.0)
    return np.diff(ahead) / sample_time


EFFECT = Effect(
    name="column_shift",
    site="setup",
    mechanism="measurement",
    parameters=(
        Parameter(
            "time", "time", lower=-0.2, upper=0.2, limits=_limits,
            meaning="s; late, early where negative",
        ),
    ),
    c="column_late += p[0];",
    sentence=(
        "The command column of joint {joint} is {time} late against the position column "
        "(negative: early): the rows are shifted."
    ),
    experiment="A step of the command: the row in which the motion begins shows the shift.",
    equation="u(t + s) in place of u(t)",
    over="acceleration",
    linear=("time",),
    column=_early,
    retime=_moved,
    hidden=True,
    least=lambda f: {"time": least_shift(f.sample_time, f.lines)},
    odds=-1.0,
    family="timing",
    rivals=("delay", "lag", "position_filter"),
    why_not=(
        "it is in the recording, not in the machine: write command and position of one sample "
        "into one row"
    ),
)
