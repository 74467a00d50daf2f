"""Axis numbers: round steps and short labels that line up."""

from __future__ import annotations

import math

from zendsp_protocol.views import NOTHING

STEPS = (1.0, 2.0, 5.0)
WHOLE = 1e9  # a whole number below it is shown whole


def round_up(value: float) -> float:
    """Return the smallest of 1, 2, 5 · 10ᵏ that is not below ``value`` (> 0)."""
    power = 10.0 ** math.floor(math.log10(value))
    for step in (*STEPS, 10.0):
        if step * power >= value * (1.0 - 1e-9):
            return step * power
    return 10.0 * power


def round_down(value: float) -> float:
    """Return the largest of 1, 2, 5 · 10ᵏ that is not above ``value`` (> 0)."""
    power = 10.0 ** math.floor(math.log10(value) + 1e-12)
    return max(step * power for step in STEPS if step * power <= value * (1.0 + 1e-9))


def ticks(bottom: float, top: float, most: int) -> list[float]:
    """About ``most`` round numbers within [bottom, top]. Where two are asked for there are at least
    two, since one number is no scale.
    """
    span = top - bottom
    if not (math.isfinite(span) and span > 0.0) or most < 1:
        return []
    step = round_up(span / max(most, 1))
    found = _multiples(bottom, top, step)[: most + 1]
    while len(found) < 2 <= most:
        step = round_down(0.6 * step)
        found = _multiples(bottom, top, step)
        if len(found) > most + 1:
            found = [found[0], found[-1]]
    return found


def log_ticks(bottom: float, top: float, most: int) -> list[float]:
    """The exponents of about ``most`` round numbers (1, 2, 5 · 10ᵏ, or decades) within 10**bottom …
    10**top; where there are fewer than two, of evenly spaced ones.
    """
    if not (math.isfinite(top - bottom) and top > bottom):
        return []
    fine = [
        k + math.log10(step)
        for k in range(math.floor(bottom), math.ceil(top) + 1)
        for step in STEPS
    ]
    found = [v for v in fine if bottom - 1e-9 <= v <= top + 1e-9]
    if len(found) > most + 1:
        found = [v for v in found if v == round(v)]
    return found if 2 <= len(found) <= most + 1 else ticks(bottom, top, most)


def _multiples(bottom: float, top: float, step: float) -> list[float]:
    first, last = math.ceil(bottom / step - 1e-9), math.floor(top / step + 1e-9)
    return [k * step for k in range(first, last + 1)]


def label(value: float, step: float) -> str:
    """``value`` with as many decimals as ``step`` needs; very large and very small ones in powers
    of ten.
    """
    if value == 0.0 or abs(value) < 1e-9 * abs(step):
        return "0"
    size = abs(value)
    if size >= 1e5 or step < 1e-4:
        return f"{value:.3g}".replace("e+0", "e").replace("e-0", "e-").replace("e+", "e")
    decimals = max(0, -math.floor(math.log10(step) + 1e-9))
    return f"{value:.{decimals}f}"


def beside(text: str, room: int) -> str:
    """A text that fits to the left of an axis; a number that does not fit ends in an ellipsis."""
    return text.rjust(room) if len(text) <= room else f"{text[: room - 1]}…"


def duration(seconds: float) -> str:
    """A time in the unit that reads best: ``250 ms``, ``2 s``, ``3 min``."""
    size = abs(seconds)
    if size == 0.0:
        return "0 s"
    if size < 1e-3:
        return f"{seconds * 1e6:.4g} µs"
    if size < 1.0:
        return f"{seconds * 1e3:.4g} ms"
    if size < 120.0:
        return f"{seconds:.4g} s"
    return f"{seconds / 60.0:.4g} min"


def number(value: float) -> str:
    """A measured value with four significant digits, in about six characters; whole numbers without
    decimals.
    """
    if not math.isfinite(value):
        return "—"
    if abs(value) < NOTHING:  # what a filter that dies away leaves
        return "0"
    if abs(value) < WHOLE and float(value).is_integer():
        return f"{value:.0f}"
    if not 1e-4 <= abs(value) < 1e6:
        return f"{value:.3e}"
    return f"{value:.5g}"


def short(value: float) -> str:
    """A measured value with four significant digits."""
    if abs(value) < NOTHING:
        return "0"
    return f"{value:.4g}" if math.isfinite(value) else "—"
