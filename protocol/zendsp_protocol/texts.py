"""Makes text from elsewhere fit to be shown, since a terminal obeys some characters."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from typing import Any

# Control characters but tab and newline, and those that turn the direction of reading.
_OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
_BREAK = re.compile(r"\s*[\n\t\r\v\f]\s*")
# Bytes without which no text has any of the dangerous ones in UTF-8. Numbers may hold them too:
# they only say where to look.
_SIGNS = b"\x1b\r\b\xc2\xe2"
# what a declared unit may say of a joint that slides, and of another
_OF_JOINTS = {"{q}": ("m", "rad"), "{tau}": ("N", "N m"), "{J}": ("kg", "kg m^2")}
EXACT = "sources"  # C code is kept as it was sent


def shown(text: str, lines: bool = True) -> str:
    r"""The text, in which every character that a terminal would obey is spelled out.

    Parameters
    ----------
    lines : bool
        Whether tabs and newlines may stay: a name has none.

    Examples
    --------
    >>> shown("\x1b[2Jgone")
    '\\x1b[2Jgone'
    """
    if not lines:
        text = text.replace("\t", "\\t").replace("\n", "\\n")
    return text if text.isprintable() else _OBEYED.sub(_written, text)


def _written(found: re.Match[str]) -> str:
    return found[0].encode("unicode_escape").decode()


def on_one_line(text: str) -> str:
    """Return a unit or a description that fits a row of a table: a program may declare several
    lines.

    Examples
    --------
    >>> on_one_line("position,\\n\\tjoint 1")
    'position, joint 1'
    """
    return _BREAK.sub(" ", text).strip()


def placed(file: str, line: int, column: int, words: str) -> str:
    """A compiler's message after its place, as compilers write it; a line or column of 0 is left
    out.

    Examples
    --------
    >>> placed("pd.c", 3, 0, "error: undefined reference to `gain'")
    "pd.c:3: error: undefined reference to `gain'"
    """
    return ": ".join((":".join([file, *(str(n) for n in (line, column) if n)]), words))


def units_of(unit: str, length: int) -> tuple[str, ...]:
    """The unit of each element: a variable has one unit, or one for each of its elements.

    Examples
    --------
    >>> units_of("rad", 2), units_of("A, V", 2)
    (('rad', 'rad'), ('A', 'V'))
    """
    each = tuple(unit.split(", "))
    return each if len(each) == length else (unit,) * length


def joint_units(unit: str, joints: Sequence[str], length: int) -> str:
    """The unit of a variable of a program that runs on any machine.

    Parameters
    ----------
    unit : str
        As it was declared: ``{q}`` is rad or m, ``{tau}`` N m or N, ``{J}`` kg m^2 or kg.
    joints : sequence of str
        Of each joint's position.
    length : int
        Elements: as many as there are joints, and each has the unit of its joint.

    Examples
    --------
    >>> joint_units("{q}/s", ["m", "rad"], 2), joint_units("{tau}/{q}", ["m"], 1)
    ('m/s, rad/s', 'N/m')
    >>> joint_units("{q}", ["m", "rad"], 1)
    'm or rad'
    """
    if "{" not in unit:
        return unit
    each = []
    for joint in joints:
        text = unit
        for word, (slides, turns) in _OF_JOINTS.items():
            text = text.replace(word, slides if joint == "m" else turns)
        each.append(text)
    different = dict.fromkeys(each)
    return ", ".join(each) if len(different) > 1 and length == len(each) else " or ".join(different)


def of_sliding(unit: str) -> str:
    """The unit at a joint that slides, of what has this unit at one that turns.

    Examples
    --------
    >>> of_sliding("N m s/rad"), of_sliding("kg m^2"), of_sliding("s")
    ('N s/m', 'kg', 's')
    """
    for slides, turns in _OF_JOINTS.values():
        unit = unit.replace(turns, slides)
    return unit


def counted(number: int, noun: str) -> str:
    """A number with its noun, in the singular where it is one.

    Examples
    --------
    >>> counted(1, "joint"), counted(7, "joint")
    ('1 joint', '7 joints')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def enumerated(words: Iterable[str], last: str = "and") -> str:
    """Words in a row: commas between them, and ``last`` before the last one.

    Examples
    --------
    >>> enumerated(["a"]), enumerated(["a", "b"]), enumerated(["a", "b", "c"], "or")
    ('a', 'a and b', 'a, b or c')
    """
    *first, end = words
    return f"{', '.join(first)} {last} {end}" if first else end


def number_hint(text: str) -> str:
    """A hint for a number with a decimal comma or a unit; empty for everything else.

    Examples
    --------
    >>> number_hint("0,15"), number_hint("1,2,3"), number_hint("0.15")
    ('; with a decimal point it is 0.15', '', '')
    >>> number_hint("10 N"), number_hint("1e-3rad"), number_hint("1 2"), number_hint("1e5")
    ('; without its unit it is 10', '; without its unit it is 1e-3', '', '')
    """
    comma = re.fullmatch(r"\s*([-+]?\d+),(\d+(?:[eE][-+]?\d+)?)\s*", text)
    if comma:
        return f"; with a decimal point it is {comma[1]}.{comma[2]}"
    unit = re.fullmatch(r"\s*([-+]?\d*\.?\d+(?:[eE][-+]?\d+)?)\s*([^\W\d_xX]|[%°]).*", text)
    exponent = re.fullmatch(r"[eE][-+]?\d*", text[unit.end(1):].strip()) if unit else None
    return f"; without its unit it is {unit[1]}" if unit and not exponent else ""


def suspicious(data: bytes) -> bool:
    """Whether encoded text could hold characters that a terminal obeys: escapes, or those that
    overwrite a line.
    """
    return len(data.translate(None, _SIGNS)) < len(data)


def shown_all(value: Any) -> Any:
    """Return a decoded message with :func:`shown` applied to each of its texts but C code."""
    kind = type(value)
    if kind is str:
        return shown(value)
    if kind is list:
        return [shown_all(item) for item in value]
    if kind is dict:
        return {
            shown_all(key): item if key == EXACT else shown_all(item) for key, item in value.items()
        }
    return value
