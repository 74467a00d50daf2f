"""From named columns to named signals: ``q[0], q[1]`` is the vector ``q``; ``q1 [rad]`` has a unit.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from zendsp.errors import RecordingError
from zendsp.recording.units import FloatArray as FloatArray
from zendsp.recording.units import to_si

LISTED = 12  # names in a sentence
_ELEMENT = re.compile(r"^(.+)\[(\d+)\]$")
# A unit that stands apart from the name by a blank may be one that is not known; "q[0]" has none.
_UNIT = re.compile(r"^(.*\S)\s+[\[(]([^\[\]()]*)[\])]$")
# Only a unit that is known: "pos(deg)", "pos<deg>", "angle, deg", "angle in deg".
_KNOWN_UNIT = re.compile(r"^(.*[^\s,])(?:[\[(<]([^\[\]()<>]*)[\])>]|(?:,| in)\s+(\S.*))$")
# What people write in brackets behind a name that says which of several signals it is. None is a
# unit: 'q (raw)' and 'q (filtered)' are two columns in SI units.
QUALIFIERS = {
    "act", "actual", "axis", "calc", "calculated", "cmd", "command", "commanded", "des", "desired",
    "est", "estimated", "fb", "feedback", "ff", "filt", "filtered", "joint", "left", "link", "load",
    "meas", "measured", "motor", "out", "output", "raw", "ref", "reference", "right", "setpoint",
    "sim", "simulated", "smoothed", "true", "unfiltered",
}  # fmt: skip


def split_element(name: str) -> tuple[str, int] | None:
    """``"q[1]"`` as ``("q", 1)``; None where the name is not an element."""
    match = _ELEMENT.match(name)
    return (match.group(1), int(match.group(2))) if match else None


def split_unit(header: str) -> tuple[str, str]:
    """Name and unit of ``"q1 [rad]"``, ``"q1(rad)"``, ``"q1, rad"`` or ``"q1 in rad"``; the unit is
    empty where none is written. A qualifier such as ``(raw)`` stays in the name.

    Examples
    --------
    >>> split_unit("q1 (rad)"), split_unit("q1 (raw)"), split_unit("q(1)"), split_unit("q in rad")
    (('q1', 'rad'), ('q1 (raw)', ''), ('q(1)', ''), ('q', 'rad'))
    """
    if match := _UNIT.match(header):
        return (header, "") if qualified(header) else (match.group(1), match.group(2))
    if match := _KNOWN_UNIT.match(header):
        unit = match.group(2) or match.group(3) or ""
        if unit != "1" and to_si(unit):
            return match.group(1).rstrip(), unit
    return header, ""


def split_heads(headers: Sequence[str]) -> list[tuple[str, str]]:
    """Names and units of the columns of a table: all as quantity / unit, or each as `split_unit`
    reads it. Names that would be the same without their units keep them.

    Examples
    --------
    >>> split_heads(["Zeit [s]", "q"]), split_heads(["q [deg]", "q [rad]"])
    ([('Zeit', 's'), ('q', '')], [('q [deg]', ''), ('q [rad]', '')])
    """
    split = split_quotients(headers) or [split_unit(header) for header in headers]
    alone = len({name for name, _ in split}) == len(headers)
    return split if alone else [(header, "") for header in headers]


def split_quotients(headers: Sequence[str]) -> list[tuple[str, str]] | None:
    """Names and units of headers that are all quantity / unit, as ISO 80000 writes them; None where
    one is not, since a slash may also separate the steps of a path.

    Examples
    --------
    >>> split_quotients(["t/s", "n / (1/min)"]), split_quotients(["t", "axis/m"])
    ([('t', 's'), ('n', '1/min')], None)
    """
    halves = [header.partition("/") for header in headers]
    split = [(name.strip(), re.sub(r"^\((.*)\)$", r"\1", unit.strip())) for name, _, unit in halves]
    return split if all(name and unit and to_si(unit) for name, unit in split) else None


def qualified(header: str) -> str:
    """The text in brackets behind a name if it is no unit, such as ``raw``; else empty."""
    match = _UNIT.match(header)
    words = re.findall(r"[^\W\d_]+", match.group(2).lower()) if match else []
    return match.group(2) if match and words and QUALIFIERS.issuperset(words) else ""


def element_names(name: str, width: int) -> list[str]:
    """The names of a signal's columns: its own name where it has one column, else ``q[0]``,
    ``q[1]``, …
    """
    return [name] if width == 1 else [f"{name}[{k}]" for k in range(width)]


def gather_vectors(
    columns: Mapping[str, FloatArray], units: Mapping[str, str]
) -> tuple[dict[str, FloatArray], dict[str, str]]:
    """The columns with complete runs ``q[0] … q[m-1]`` (m > 1) joined into one ``(N, m)`` signal
    ``q``; others are unchanged.

    Parameters
    ----------
    columns : mapping of name to array, shape (N,) or (N, m)
    units : mapping of name to unit

    Returns
    -------
    columns, units : dict
        In the order in which the first element of each signal appeared; the unit of a vector whose
        elements differ has one for each: ``"m, rad"``.
    """
    groups: dict[str, dict[int, str]] = {}
    for name, values in columns.items():
        element = split_element(name)
        if element and values.ndim == 1:
            groups.setdefault(element[0], {})[element[1]] = name
    whole = {
        base: [members[k] for k in range(len(members))]
        for base, members in groups.items()
        if len(members) > 1 and set(members) == set(range(len(members))) and base not in columns
    }
    joined: dict[str, FloatArray] = {}
    joined_units: dict[str, str] = {}
    for name, values in columns.items():
        element = split_element(name)
        base = element[0] if element and element[0] in whole and name in whole[element[0]] else ""
        if not base:
            joined[name] = values
            joined_units[name] = units.get(name, "")
        elif base not in joined:
            joined[base] = np.column_stack([columns[member] for member in whole[base]])
            each = [units.get(member, "") for member in whole[base]]
            joined_units[base] = each[0] if len(set(each)) == 1 else ", ".join(each)
    return joined, joined_units


def units_in(units: Mapping[str, str], name: str) -> list[str]:
    """The units of a signal: one, or one for each element of a vector; for ``"q[1]"`` that of the
    element.

    Examples
    --------
    >>> units_in({"q": "m, rad", "u": "N"}, "q[1]"), units_in({"q": "m, rad", "u": "N"}, "q")
    (['rad'], ['m', 'rad'])
    """
    bare = split_unit(name)[0]
    element = split_element(bare)
    if units.get(bare) or element is None:
        return (units.get(bare) or units.get(f"{bare}[0]", "")).split(", ")
    each = units.get(element[0], "").split(", ")
    return [each[min(element[1], len(each) - 1)]]


def _bound(value: object) -> str:
    return "" if value is None else str(value)


def pick(columns: Mapping[str, FloatArray], name: str) -> FloatArray | None:
    """A signal by name, or one column of a vector by ``"q[1]"``; None where there is neither. A
    signal of one column is ``q`` and ``q[0]``, whichever name it was recorded by.

    Raises
    ------
    RecordingError
        Something that is no name; the message says what to write.

    Examples
    --------
    >>> pick({"q": np.zeros(3)}, "q[0]"), pick({"q[0]": np.ones(3)}, "q"), pick({}, "q")
    (array([0., 0., 0.]), array([1., 1., 1.]), None)
    """
    if not isinstance(name, str):
        first = next(iter(columns), "q")
        rows = f"{_bound(name.start)}:{_bound(name.stop)}" if isinstance(name, slice) else name
        raise RecordingError(
            f"[{rows}]: channels are taken by their names, and rows of one behind that:"
            f" [{first!r}][{rows}]"
        )
    if name in columns:
        return columns[name]
    element = split_element(name)
    if element and element[0] in columns:
        values = columns[element[0]]
        width = values.shape[1] if values.ndim == 2 else 1
        if element[1] < width:
            return values[:, element[1]] if values.ndim == 2 else values
    elements = [split_element(column) for column in columns]
    alone = [found[1] for found in elements if found and found[0] == name] == [0]
    return columns[f"{name}[0]"] if alone else None


def told(columns: Mapping[str, FloatArray]) -> list[str]:
    """The names of columns for a message; of a vector those of its elements.

    Examples
    --------
    >>> told({"t": np.zeros(5), "data": np.zeros((5, 4))})
    ['t', 'data[0] … data[3]']
    """
    return [
        f"{name}[0] … {name}[{values.shape[1] - 1}]" if values.ndim == 2 else name
        for name, values in columns.items()
    ]


def listing(names: Sequence[str]) -> str:
    """Names as part of a sentence, cut short where there are very many."""
    more = f", … ({len(names)} in all)" if len(names) > LISTED else ""
    return ", ".join(names[:LISTED]) + more or "none"
