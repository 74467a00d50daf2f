"""Values of variables on the wire: bool, int, float, a list of these, or a packed array.

A packed array is ``{"dtype": "<f8", "data": <binary, little endian>, "columns": 1}`` with dtype one
of ``<f8 <f4 <i4 <i8 |b1``; with more columns it holds the rows of a table or a matrix, one after
the other.
Short arrays travel as lists so that any client can read them; long ones packed, 60 times faster.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import msgspec

from zendsp_protocol.lazily import Lazily

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    Value = bool | int | float | npt.NDArray[Any]
    Assignable = npt.ArrayLike  # what a user may write: a number, lists of numbers, an array
else:
    np = Lazily("numpy")
    Value = Assignable = Any

LIST_LIMIT = 64  # elements; longer arrays are packed
DTYPES = ("<f8", "<f4", "<i4", "<i8", "|b1")


class Packed(msgspec.Struct, frozen=True):
    """An array as bytes."""

    dtype: str
    data: bytes
    columns: int = 1

    def __repr__(self) -> str:
        return f"<Packed {len(self.data) // np.dtype(self.dtype).itemsize} x {self.dtype}>"


WORD = 63  # bits of the largest whole number that is sent, beside its sign

if TYPE_CHECKING:  # the target's own side puts arrays into its messages; `enc_hook` packs them
    WireValue = bool | int | float | list[bool | int | float] | Packed | npt.NDArray[Any]
else:
    WireValue = bool | int | float | list[bool | int | float] | Packed


def to_wire(value: Any) -> WireValue:
    """A Python or NumPy value as it goes over the wire.

    Raises
    ------
    TypeError
        Not a number, a bool, or an array of these with one or two dimensions.
    """
    kind = type(value)
    if kind is int and value.bit_length() > WORD:
        raise TypeError(f"a whole number of {value.bit_length()} bits fits no variable")
    if kind is float or kind is int or kind is bool:
        return value  # type: ignore[no-any-return]
    try:
        array = np.asarray(value)
    except ValueError:
        raise TypeError(f"{value!r} is no matrix: its rows differ in length") from None
    if isinstance(value, list | tuple):
        _check_mixed(value)
    if array.dtype.kind not in "fiub":
        raise TypeError(f"{value!r} is not a number")
    if array.ndim == 0:
        return array.item()  # type: ignore[no-any-return]
    if array.ndim > 2:
        raise TypeError(f"an array of shape {array.shape} has more than two dimensions")
    if array.ndim == 1 and array.size <= LIST_LIMIT:
        return array.tolist()  # type: ignore[no-any-return]
    dtype = {"f4": "<f4", "i4": "<i4", "i8": "<i8", "b1": "|b1"}.get(array.dtype.str[1:], "<f8")
    columns = array.shape[1] if array.ndim == 2 else 1
    return Packed(dtype, np.ascontiguousarray(array, dtype=dtype).tobytes(), columns)


def from_wire(value: WireValue) -> Value:
    """A received value as Python numbers or a NumPy array.

    Raises
    ------
    ValueError
        Unknown dtype, or bytes that are no whole number of elements.
    """
    if isinstance(value, Packed):
        if value.dtype not in DTYPES:
            raise ValueError(
                f"packed array of unknown dtype {value.dtype!r}; known: {', '.join(DTYPES)}"
            )
        row = np.dtype(value.dtype).itemsize * value.columns
        if row <= 0 or len(value.data) % row:
            raise ValueError(
                f"packed array of {len(value.data)} bytes holds no whole number of rows of"
                f" {value.columns} {value.dtype}"
            )
        array = np.frombuffer(value.data, dtype=value.dtype)
        return array if value.columns == 1 else array.reshape(-1, value.columns)
    if isinstance(value, list):
        try:
            _check_mixed(value)
        except TypeError as error:
            raise ValueError(str(error)) from error
        return np.array(value)
    return value


def _check_mixed(values: list[Any] | tuple[Any, ...]) -> None:
    """Refuse true or false among numbers, which NumPy would turn into numbers."""
    flags = sum(isinstance(item, bool | np.bool_) for item in values)
    if 0 < flags < len(values):
        raise TypeError(f"{values!r} mixes true or false with what is not a number of that kind")


def enc_hook(value: Any) -> Any:
    """NumPy arrays and scalars in types that msgspec can encode."""
    if isinstance(value, np.ndarray):
        return to_wire(value)
    if isinstance(value, np.generic):
        return value.item()
    raise NotImplementedError(f"cannot send a {type(value).__name__}")
