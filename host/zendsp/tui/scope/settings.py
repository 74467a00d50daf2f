"""What the user has set on the scope, apart from any data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

WINDOWS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
MOST_CHANNELS = 8
VIEWS = ("time", "xy", "spectrum")
LANES = ("unit", "curve", "over")


@dataclass(frozen=True)
class Channel:
    """One curve."""

    name: str  # a variable, an array element "q[0]", a built-in signal, or of a formula
    unit: str = ""
    formula: str = ""  # what it is computed by; "" for a signal of the target


@dataclass(frozen=True)
class Scale:
    """The scale of one curve that has its own."""

    lane: int = 0  # curves of one number share a lane; 0: as the others
    low: float | None = None  # at the bottom, in the curve's unit; None: what is seen
    high: float | None = None


@dataclass(frozen=True)
class ScopeSettings:
    """All settings of the scope. They are immutable, so that a picture is drawn from a consistent
    set.
    """

    mode: str = "roll"  # "roll" | "trigger"
    window: float = 5.0  # s across the picture
    view: str = "time"  # one of VIEWS: over time; over the selected curve; over frequency
    lanes: str = "unit"  # one of LANES: a lane for each unit, for each curve; all over one another
    scales: Mapping[str, Scale] = field(default_factory=dict)  # by name of the curve
    auto: bool = True  # y range follows what is seen
    source: int = 0  # channel index of the trigger
    level: float = 0.0  # in the unit of the source
    edge: str = "rising"  # "rising" | "falling" | "both"
    pre: float = 0.2  # share of the window before the trigger
    selected: int = 0  # the curve whose cursor values are shown, drawn on top
    cursors: bool = False
    cursor_a: float = 0.33  # share of the window
    cursor_b: float = 0.66
    active: str = "a"  # the cursor that the arrow keys move
