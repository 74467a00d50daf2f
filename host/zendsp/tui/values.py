"""Values of variables as text, and text as values."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from zendsp.tui.scope.ticks import number
from zendsp.tui.snapshot import Variable
from zendsp_protocol.texts import number_hint
from zendsp_protocol.views import NOTHING

LARGEST = 2.0**31 - 1.0
COUNTS = 1e7  # a whole number below it is shown whole

def show_value(value: Any, most: int = 4) -> str:
    """A value as text for a cell; a long array shows its first elements and its length."""
    if value is None:
        return "—"
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return number(float(value))
    items = np.ravel(np.asarray(value))
    if items.dtype.kind == "f" and len(items) > 1:
        text = " ".join(_element(float(v)) for v in items[:most])
    else:
        text = " ".join(show_value(v.item()) for v in items[:most])
    return f"{text} …" if len(items) > most else text


def _element(value: float) -> str:
    """One of several numbers in a cell: counts in full, others with three digits."""
    whole = value.is_integer() and abs(value) < COUNTS
    return str(int(value)) if whole or abs(value) < NOTHING else f"{value:.3g}"


def show_exact(value: Any) -> str:
    """A value as text from which the same value can be read back, for edit fields and comparisons.
    """
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, int | np.integer):
        return str(int(value))
    if isinstance(value, float | np.floating):
        return repr(float(value)).removesuffix(".0")
    return " ".join(show_exact(v.item()) for v in np.ravel(np.asarray(value)))


def show_limits(variable: Variable) -> str:
    """The limits as ``0 … 5000`` or ``≥ 0``, or an empty text."""
    low, high = math.isfinite(variable.minimum), math.isfinite(variable.maximum)
    high = high and variable.maximum < LARGEST  # what no int32 passes is no limit
    if low and high:
        return f"{variable.minimum:g} … {variable.maximum:g}"
    return f"≥ {variable.minimum:g}" if low else f"≤ {variable.maximum:g}" if high else ""


def differs(a: Any, b: Any) -> bool:
    """Whether two values are not the same."""
    return not np.array_equal(np.ravel(a), np.ravel(b), equal_nan=False)


def _whole(word: str) -> int:
    """A whole number, however it is written: 1000, 0x3e8, 1e3."""
    try:
        return int(word, 0)
    except ValueError:
        value = float(word)
        if not value.is_integer():
            raise
        return int(value)


def _scalar(variable: Variable, text: str) -> Any:
    word = text.strip().lower()
    if variable.type == "bool":
        if word in ("true", "1", "on", "yes"):
            return True
        if word in ("false", "0", "off", "no"):
            return False
        raise ValueError(f"{text!r} is neither true nor false")
    if variable.type == "int32":
        try:
            value: float = _whole(word)
        except (ValueError, OverflowError):
            raise ValueError(f"{text!r} is not a whole number{number_hint(text)}") from None
    else:
        try:
            value = float(word)
        except ValueError:
            raise ValueError(f"{text!r} is not a number{number_hint(text)}") from None
    if not math.isfinite(value):
        raise ValueError(f"{text} is not finite")
    if not variable.minimum <= value <= variable.maximum:
        raise ValueError(f"{value:g} is outside {show_limits(variable)} {variable.unit}".rstrip())
    return value


def reader(variable: Variable) -> Callable[[str], Any]:
    """The check of an edit field: from text to a value within the limits, or ValueError with the
    reason.
    """

    def read(text: str) -> Any:
        if variable.length == 1:
            return _scalar(variable, text)
        items = [_scalar(variable, word) for word in text.replace(",", " ").split()]
        if len(items) == 1:
            items *= variable.length
        if len(items) != variable.length:
            raise ValueError(
                f"{len(items)} numbers; {variable.name} has {variable.length} elements: give 1 or"
                f" {variable.length}"
            )
        return items

    return read
