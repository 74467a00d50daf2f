"""What the user has set on the scope, apart from any data."""

from __future__ import annotations

from dataclasses import dataclass

WINDOWS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
MOST_CHANNELS = 8


@dataclass(frozen=True)
class Channel:
    """One curve."""

    name: str  # a variable, an array element "q[0]", or a built-in signal
    unit: str = ""


@dataclass(frozen=True)
class ScopeSettings:
    """All knobs; a frozen value, so that a redraw always sees a consistent set."""

    mode: str = "roll"  # "roll" | "trigger"
    window: float = 5.0  # s across the picture
    lanes: bool = True  # one lane for each unit, else all curves over one another
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
