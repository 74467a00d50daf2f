"""Check values before anything is written: type, length, limits, NaN. One line for each variable that is wrong."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp_protocol.errors import VariableError
from zendsp_target.dictionary import Place

_INT32 = np.iinfo(np.int32)


def encode(name: str, place: Place, value: object) -> bytes:
    """The bytes to write into a variable or an element.

    Parameters
    ----------
    name : str
        As the host gave it, for the message.
    place : Place
        Not a table.
    value : bool, int, float, sequence or ndarray

    Returns
    -------
    bytes
        In the variable's own type.

    Raises
    ------
    VariableError
        What is wrong with this variable: value, limit, and what to do.
    """
    _check_kind(name, place)
    array = _as_elements(name, place, _numbers(name, value, place.entry.info.type))
    _check_limits(name, place, array)
    return _typed(name, place, array).tobytes()


def encode_table(name: str, place: Place, value: object) -> npt.NDArray[np.float64]:
    """The rows to write into a table.

    Parameters
    ----------
    name : str
    place : Place
        A table.
    value : sequence or ndarray, shape (rows, columns), or flat row after row

    Returns
    -------
    ndarray, shape (rows, columns)
        C-contiguous.

    Raises
    ------
    VariableError
        Wrong shape, more rows than its capacity, or NaN.
    """
    array = _as_rows(name, place, _numbers(name, value, place.entry.info.type))
    _check_limits(name, place, array)
    return np.ascontiguousarray(array)


def _check_kind(name: str, place: Place) -> None:
    kind = place.entry.info.kind
    if kind not in ("parameter", "setting"):
        raise VariableError(f"{name}: is a {kind}, read only; declare it with PARAMETER to write it")


def _check_limits(name: str, place: Place, array: npt.NDArray[np.float64]) -> None:
    info = place.entry.info
    flat = array.ravel()
    bad = np.flatnonzero(~np.isfinite(flat))
    if bad.size:
        raise VariableError(f"{name}: {flat[bad[0]]} is not a finite number{_at(array, bad[0])}; nothing was written")
    outside = np.flatnonzero((flat < info.minimum) | (flat > info.maximum))
    if outside.size:
        unit = f" {info.unit}" if info.unit else ""
        limits = f"{info.minimum:g} … {info.maximum:g}{unit}"
        raise VariableError(f"{name}: {flat[outside[0]]:g}{unit} is outside its limits {limits}{_at(array, outside[0])}")


def _at(array: npt.NDArray[Any], index: np.intp) -> str:
    return f" (element {int(index)})" if array.size > 1 else ""


def _numbers(name: str, value: object, kind: str) -> npt.NDArray[np.float64]:
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "biuf":
            raise TypeError
        numbers = array.astype(np.float64)
    except (TypeError, ValueError):
        raise VariableError(f"{name}: {_short(value)} is not a number or an array of numbers") from None
    if array.dtype.kind == "b" and kind != "bool":
        raise VariableError(f"{name}: {_short(value)} is true or false, not a number, which a {kind} needs; write 1 or 0 if that is meant")
    return numbers


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else text[:37] + "…"


def _as_elements(name: str, place: Place, array: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    wanted = 1 if place.element is not None else place.entry.info.length
    if array.size != wanted or array.ndim > 1:
        given = f"an array of shape {array.shape}" if array.ndim else "one number"
        needs = f"{wanted} numbers" if wanted > 1 else "one number"
        raise VariableError(f"{name}: needs {needs}, got {given}")
    return array.reshape(wanted)


def _as_rows(name: str, place: Place, array: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    columns = place.entry.info.columns
    if array.ndim == 1 and array.size % columns == 0:
        array = array.reshape(-1, columns)
    if array.ndim != 2 or array.shape[1] != columns:
        raise VariableError(f"{name}: needs shape (rows, {columns}), got {array.shape}")
    if array.shape[0] > place.entry.rows:
        raise VariableError(f"{name}: {array.shape[0]} rows exceed its capacity of {place.entry.rows}; declare a larger TABLE")
    return array


def _typed(name: str, place: Place, array: npt.NDArray[np.float64]) -> npt.NDArray[Any]:
    kind = place.entry.info.type
    if kind == "int32" and (np.any(array != np.rint(array)) or np.any(array < _INT32.min) or np.any(array > _INT32.max)):
        raise VariableError(f"{name}: {_short(array.tolist())} is not a 32-bit integer")
    if kind == "bool" and np.any((array != 0.0) & (array != 1.0)):
        raise VariableError(f"{name}: {_short(array.tolist())} is neither true nor false (1 or 0)")
    if kind == "float" and np.any(np.abs(array) > np.finfo(np.float32).max):
        raise VariableError(f"{name}: {_short(array.tolist())} exceeds the range of float")
    return array.astype(place.entry.dtype)
