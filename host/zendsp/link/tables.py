"""Sends large arrays to the target, in chunks with checksums; the loop switches over in one sample
when all are there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from zendsp.errors import VariableError, did_you_mean
from zendsp.link.requests import PATIENCE_S, Part
from zendsp_protocol import messages as m
from zendsp_protocol.chunks import CHUNK, crc, spans
from zendsp_protocol.lazily import Lazily
from zendsp_protocol.states import VariableKind

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt
else:
    np = Lazily("numpy")

_DTYPES = {"double": "<f8", "float": "<f4", "int32": "<i4", "bool": "|b1"}


class Tables(Part):
    """Large arrays of a target's program."""

    def upload(
        self,
        name: str,
        values: npt.ArrayLike,
        at_tick: int | None = None,
        progress: Callable[[float], None] | None = None,
        patience: float = PATIENCE_S,
    ) -> int:
        """Send a large array, for example a reference of several minutes, while the loop runs.

        Parameters
        ----------
        name : str
            A variable of the running code, declared as a table or an array.
        values : array
            Its rows and columns, or all of its numbers, row after row.
        at_tick : int, optional
            The sample at which to switch over; default: the next one.
        progress : callable, optional
            Called with the fraction sent.
        patience : float, s
            How long to wait for a broken link to come back; the upload resumes where it stopped.

        Returns
        -------
        int
            The sample from which the program sees the new values.

        Raises
        ------
        VariableError
            No such variable, or the array does not fit.
        """
        infos = {info.name: info for info in self.request("variables")}
        if name not in infos:
            arrays = [info.name for info in infos.values() if info.length > 1]
            which = did_you_mean(name, arrays) if arrays else "it has no table and no array"
            raise VariableError(f"{name}: no such variable in the running code; {which}")
        if infos[name].length == 1:
            raise VariableError(f'{name}: is one number, no table: target["{name}"] = … writes it')
        dtype = _DTYPES[infos[name].type]
        if np.asarray(values).dtype.kind == "b" and dtype != "|b1":
            raise VariableError(
                f"{name}: true or false is not a number, which a {infos[name].type} needs"
            )
        array = np.ascontiguousarray(values, dtype=dtype)
        _check_shape(infos[name], array.shape)
        array = array.reshape(-1)
        data = array.tobytes()
        begun = self.request(
            "table_begin", name=name, dtype=dtype, length=array.size, crc=crc(data)
        )
        for offset, size in spans(0, len(data), CHUNK):
            part = data[offset : offset + size]
            self.insist(
                "table_chunk", patience, upload=begun.upload, offset=offset, data=part,
                crc=crc(part),
            )
            if progress is not None:
                progress((offset + size) / len(data))
        applied: m.Applied = self.request("table_commit", upload=begun.upload, at_tick=at_tick)
        return applied.tick


def _check_shape(info: m.VariableInfo, shape: tuple[int, ...]) -> None:
    """Refuse an empty array, and one whose columns are not those of the table."""
    rows = "rows" if info.kind == VariableKind.TABLE else info.length // info.columns
    if len(shape) > 1 and (len(shape) > 2 or shape[1] != info.columns):
        raise VariableError(
            f"{info.name}: needs shape ({rows}, {info.columns}), or its numbers row after row; got"
            f" {shape}"
        )
    if 0 in shape:
        raise VariableError(f"{info.name}: is to be filled with an empty array; give a row or more")
