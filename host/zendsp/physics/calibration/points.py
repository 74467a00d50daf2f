"""The innovations of one joint of a recording while the free numbers of a model move, as a fit
evaluates them.

Everything that the numbers do not change is filled in for the kernel once, not at every point.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.handles import LEADER, Handle, set_values
from zendsp.physics.calibration.joint import JointRecord
from zendsp.physics.calibration.predict import (
    fill,
    fill_rigid,
    fill_shift,
    pack,
    unbent,
)
from zendsp.physics.effects import get_effect
from zendsp.physics.kernel.native import LANES, native
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]


class Points:
    """Weighted innovations of one joint at points of the numbers behind some handles.

    Parameters
    ----------
    model : Model
        In kernel form.
    handles : sequence of Handle
        What moves.
    bandwidth : float
        Of the observer, rad/s.
    inner : int
        Integration steps per sample.
    """

    def __init__(
        self,
        record: JointRecord,
        model: Model,
        handles: Sequence[Handle],
        bandwidth: float,
        inner: int,
    ) -> None:
        self.record, self.model, self.handles = record, model, handles
        self.bandwidth, self.inner = bandwidth, inner
        self.packed = pack(model.at(record.joint))
        self._base = native().ffi.new("zk_model *")
        self._alive = fill(self._base, record, model, bandwidth, inner, packed=self.packed)
        self._base.unbent = unbent(record, model, bandwidth, inner)
        # of each handle that this joint feels, by what it moves
        self._cells: list[tuple[int, int, int, int]] = []  # handle, row, column, less
        self._ratios: list[tuple[int, int, int, int]] = []  # handle, row, column, that of what
        self._gain: list[int] = []
        self._shift: list[int] = []
        self._gravity: list[int] = []  # only what the kernel multiplies with a sine
        self._rigid: list[int] = []  # inertia and known torque
        for i, handle in enumerate(handles):
            self._sort(i, handle)
        cells = [cell[0] for cell in (*self._cells, *self._ratios)]
        self._felt = [*cells, *self._gain, *self._shift, *self._gravity, *self._rigid]

    def _sort(self, i: int, handle: Handle) -> None:
        record, model = self.record, self.model
        here = handle.index == record.joint - 1
        if handle.place == "gain":
            self._gain += [i] * here
        elif handle.place == "offset":
            self._shift += [i] * here
        elif handle.place == "mechanism":
            alone = len(model.mechanism[handle.key]) < record.joint and handle.index == 0
            if (here or alone) and handle.key in record.basis:
                self._rigid.append(i)
            elif (here or alone) and handle.key == "gravity" and model.kind == "rotary":
                self._gravity.append(i)
        else:
            term = model.terms[handle.index]
            effect = get_effect(term.effect)
            if effect.site == "body":
                self._rigid.append(i)
            elif term.joint == record.joint:
                row = sum(
                    t.joint == record.joint and get_effect(t.effect).site != "body"
                    for t in model.terms[: handle.index]
                )
                column = effect.names.index(handle.key)
                less = int(effect.parameter(handle.key).size == "joint")
                if handle.tie is not None:
                    self._ratios.append((i, row, column, effect.names.index(LEADER)))
                else:
                    self._cells.append((i, row, column, less))

    def innovations(self, points: Sequence[Array], out: Array) -> None:
        """Weighted innovations at one point, ``out`` (n,), or at up to eight points, the first
        columns of ``out`` (n, 8). Points that are equal for this joint are run once.
        """
        places: dict[tuple[float, ...], int] = {}
        place = [
            places.setdefault(tuple(float(at[i]) for i in self._felt), len(places))
            for at in points
        ]
        if len(places) == len(points):
            self._run(points, out)
        elif len(places) == 1:
            one = np.empty(self.record.n)
            self._run(points[:1], one)
            out[:, : len(points)] = one[:, None]
        else:
            self._run([points[place.index(i)] for i in range(len(places))], out)
            out[:, : len(points)] = out[:, place]

    def _run(self, points: Sequence[Array], out: Array) -> None:
        lib, count = native(), len(points)
        kinds, table = self.packed
        at = np.stack(points) if self._felt else np.zeros((count, 0))
        tables = np.repeat(table[None], count, axis=0)
        for i, row, column, less in self._cells:
            tables[:, row, column] = at[:, i] - less
        for i, row, column, leader in self._ratios:
            tables[:, row, column] = at[:, i] * tables[:, row, leader]
        m = lib.ffi.new("zk_model[]", LANES)
        p = lib.doubles(tables)
        known: dict[tuple[float, ...], list[Any]] = {}  # the lane of each
        for lane in range(count):
            m[lane] = self._base[0]
            m[lane].p = p + lane * table.size
            for i in self._gain:
                m[lane].gain = at[lane, i]
            for i in self._shift:
                fill_shift(m[lane], self.record, at[lane, i])
            if self._rigid:
                self._fill_rigid(m, lane, at[lane], known)
            for i in self._gravity:
                m[lane].gravity = at[lane, i]
        if count == 1:
            nothing = lib.ffi.NULL
            lib.lib.zk_run(m, lib.doubles(out), nothing, nothing, nothing)
            return
        for lane in range(count, LANES):
            m[lane] = m[0]  # idle
        lib.lib.zk_run_lanes(m, lib.doubles(out))
        del kinds, known

    def _fill_rigid(
        self, m: Any, lane: int, at: Array, known: dict[tuple[float, ...], list[Any]]
    ) -> None:
        """Fill in inertia and known torque at a point, computed once for each of their values."""
        values = tuple(float(at[i]) for i in self._rigid)
        if values in known:
            first = m[known[values][0]]
            m[lane].inertia, m[lane].bias = first.inertia, first.bias
            m[lane].bias_slope, m[lane].reference = first.bias_slope, first.reference
            return
        model = set_values(self.model, [self.handles[i] for i in self._rigid], np.array(values))
        inertia, bias = self.record.inertia_and_bias(model)
        known[values] = [lane, inertia, bias]
        fill_rigid(m[lane], self.record, model, inertia, bias)
