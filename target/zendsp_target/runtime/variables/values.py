"""Turns values that a host gives into numbers to write, and says why a value cannot be written, in
one line for each variable.

Limits, NaN and whole numbers are checked in one place for all updates, ``monitor_fit`` of
``monitor.c``, which is asked here for the reason.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_protocol.errors import VariableError
from zendsp_protocol.states import VariableKind
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.variables.dictionary import Place
from zendsp_target.runtime.variables.plans import set_part

FloatArray = npt.NDArray[np.float64]
SHOWN = 40  # characters of a wrong value, in the sentence that refuses it


def numbers_of(name: str, place: Place, value: object) -> FloatArray:
    """The numbers to write into a variable, an element or a table.

    Parameters
    ----------
    name : str
        As the host gave it, for the message.
    value : bool, int, float, sequence or ndarray
        Of a table: shape (rows, columns), or flat row after row.

    Returns
    -------
    ndarray, shape (elements,); of a table (rows, columns)
        C-contiguous.

    Raises
    ------
    VariableError
        What is wrong with this variable: value, limit, and what to do.
    """
    array = _numbers(name, value, place.entry.info.type)
    table = place.entry.info.kind == VariableKind.TABLE
    array = _as_rows(name, place, array) if table else _as_elements(name, place, array)
    _check_fit(name, place, array)
    return array


def check_kind(name: str, place: Place, settings: bool) -> None:
    """Raise VariableError unless a variable may be written. Settings of the runtime are written by
    their own verbs only.
    """
    kind = place.entry.info.kind
    if (kind == VariableKind.SETTING) != settings:
        raise VariableError(
            f"{name}: is a setting of the runtime; use set_limits, set_ramp or set_overrun"
        )
    if kind not in (VariableKind.PARAMETER, VariableKind.SETTING, VariableKind.TABLE):
        raise VariableError(
            f"{name}: is a {kind}, read only; declare it with PARAMETER to write it"
        )


def _check_fit(name: str, place: Place, array: FloatArray) -> None:
    ffi, lib = layout()
    part, wrong = ffi.new("update_part *"), ffi.new("uint32_t *")
    set_part(part, place, array.size)
    why = lib.monitor_fit(part, 1, ffi.from_buffer("double[]", array), wrong)
    if why == lib.FIT:
        return
    info, number = place.entry.info, array.ravel()[wrong[0]]
    at = f"{wrong[0] // info.columns},{wrong[0] % info.columns}" if place.entry.matrix else wrong[0]
    where = f" (element {at})" if array.size > 1 else ""
    unit = f" {info.unit}" if info.unit else ""
    words = {
        lib.FIT_NOT_FINITE: f"{number} is not a finite number{where}; nothing was written",
        lib.FIT_OUTSIDE: (
            f"{number:g}{unit} is outside its limits {info.minimum:g} …"
            f" {info.maximum:g}{unit}{where}"
        ),
        lib.FIT_NOT_WHOLE: f"{number} is not a 32-bit integer{where}",
        lib.FIT_NO_FLAG: f"{number} is neither true nor false (1 or 0){where}",
        lib.FIT_TOO_LARGE: f"{number} exceeds the range of float{where}",
    }
    raise VariableError(f"{name}: {words[why]}")


def _numbers(name: str, value: object, kind: str) -> FloatArray:
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biuf":
            raise TypeError
        numbers = array.astype(np.float64)
    except (TypeError, ValueError):
        raise VariableError(
            f"{name}: {_short(value)} is not a number or an array of numbers"
        ) from None
    if array.dtype.kind == "b" and kind != "bool":
        raise VariableError(
            f"{name}: {_short(value)} is true or false, not a number, which a {kind} needs; write 1"
            " or 0 if that is meant"
        )
    return numbers


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= SHOWN else text[: SHOWN - 1] + "…"


def _as_elements(name: str, place: Place, array: npt.NDArray[Any]) -> FloatArray:
    entry = place.entry
    wanted = 1 if place.element is not None else entry.info.length
    shape = (entry.rows, entry.info.columns)
    whole = entry.matrix and place.element is None
    if array.size != wanted or (array.ndim > 1 and not (whole and array.shape == shape)):
        given = f"an array of shape {array.shape}" if array.ndim else "one number"
        needs = f"{wanted} numbers" if wanted > 1 else "one number"
        needs = f"shape {shape} or {needs}" if whole else needs
        raise VariableError(f"{name}: needs {needs}, got {given}")
    return np.ascontiguousarray(array.reshape(wanted))


def _as_rows(name: str, place: Place, array: npt.NDArray[Any]) -> FloatArray:
    columns = place.entry.info.columns
    if array.ndim == 1 and array.size % columns == 0:
        array = array.reshape(-1, columns)
    if array.ndim != 2 or array.shape[1] != columns:
        raise VariableError(f"{name}: needs shape (rows, {columns}), got {array.shape}")
    if array.shape[0] > place.entry.rows:
        raise VariableError(
            f"{name}: {array.shape[0]} rows exceed its capacity of {place.entry.rows}; declare a"
            " larger TABLE"
        )
    return np.ascontiguousarray(array)
