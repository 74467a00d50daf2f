"""Verbs of variables and large arrays, in terms of a runtime."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import cast

import msgspec
import numpy as np

from zendsp_protocol import messages as m
from zendsp_protocol import values, verbs
from zendsp_protocol.errors import NotYet, Refused, RunnerDied, VariableError
from zendsp_protocol.states import ProgramState, VariableKind
from zendsp_protocol.values import Value
from zendsp_target.api import RuntimeApi
from zendsp_target.serving.deferred import Later
from zendsp_target.serving.uploads import Uploads

PLAIN = frozenset((float, int, bool))
APPLY_INLINE_S = 0.0005  # an update that needs longer is finished by another thread
APPLY_LIMIT_S = 5.0
LONGEST_FADE_S = 2.0  # well within the time that a host waits
SHOW_LIMIT_S = 2.0  # a reading waits no longer for what its host wrote before


class VariableVerbs:
    """Handlers: ``do_<verb>(arguments, author) -> result``."""

    def __init__(self, runtime: RuntimeApi) -> None:
        self.runtime = runtime
        self.uploads = Uploads()

    def do_variables(self, args: verbs.Nothing, by: str) -> tuple[m.VariableInfo, ...]:
        return tuple(_light(info) for info in self.runtime.variables())

    def do_builtins(self, args: verbs.Nothing, by: str) -> tuple[m.VariableInfo, ...]:
        return self.runtime.builtins()

    def do_read(self, args: verbs.Read, by: str) -> Mapping[str, object]:
        if args.after and not self._shown(args.after, APPLY_INLINE_S):
            raise Later(partial(self._read_late, args))
        return self._read(args)

    def _read_late(self, args: verbs.Read) -> Mapping[str, object]:
        self._shown(args.after, SHOW_LIMIT_S)  # what hangs is read as it stands
        return self._read(args)

    def _shown(self, sequence: int, timeout: float) -> bool:
        """Wait until an update can be read or never will be; False where neither is so within the
        timeout.
        """
        try:
            self.runtime.wait_applied(sequence, timeout)
        except NotYet:
            return False
        except (RunnerDied, Refused):
            pass
        return True

    def _read(self, args: verbs.Read) -> Mapping[str, object]:
        ended = self.runtime.ended()  # first: what is read then is not older
        tick, found = self.runtime.read(args.names)
        return (
            {"tick": tick, "values": found, "ended": ended}
            if ended
            else {"tick": tick, "values": found}
        )

    def do_check(self, args: verbs.Write, by: str) -> m.Empty:
        fade_of(self.runtime, args.fade)
        self.runtime.check(self._given(args), args.at_tick)
        return m.Empty()

    def do_write(self, args: verbs.Write, by: str) -> m.Written:
        given = self._given(args)
        if not args.fade:
            return m.Written(sequence=self.runtime.write(given, by, args.at_tick))
        fade = fade_of(self.runtime, args.fade)
        return m.Written(sequence=self.runtime.write(given, by, args.at_tick, fade))

    def _given(self, args: verbs.Write) -> Mapping[str, Value]:
        if PLAIN.issuperset(map(type, args.values.values())):
            return cast("dict[str, Value]", args.values)
        return self._unpacked(args.values)

    def do_update(self, args: verbs.Write, by: str) -> m.Applied:
        return applied(self.runtime, self.do_write(args, by).sequence)

    def do_wait_applied(self, args: verbs.Wait, by: str) -> m.Applied:
        tick = self.runtime.wait_applied(args.sequence, min(60.0, args.timeout))  # also of a NaN
        return m.Applied(sequence=args.sequence, tick=tick)

    def do_log(self, args: verbs.Log, by: str) -> tuple[m.Change, ...]:
        return self.runtime.log(args.since)

    def _unpacked(self, given: Mapping[str, values.WireValue]) -> Mapping[str, Value]:
        """The values of a request as numbers and arrays."""
        try:
            plain = {name: values.from_wire(value) for name, value in given.items()}
        except ValueError as error:
            raise VariableError(str(error)) from error
        return self._shaped(plain)

    def _shaped(self, given: Mapping[str, Value]) -> Mapping[str, Value]:
        """The values, with rows and columns restored for tables that came flat."""
        flat = {n: v for n, v in given.items() if isinstance(v, np.ndarray) and v.ndim == 1}
        infos = self.runtime.variables()
        columns = {i.name: i.columns for i in infos if i.kind == VariableKind.TABLE}
        fits = [n for n in flat if n in columns and flat[n].size % columns[n] == 0]
        return {**given, **{n: flat[n].reshape(-1, columns[n]) for n in fits}}

    def do_table_begin(self, args: verbs.TableBegin, by: str) -> verbs.TableState:
        self._check_table(args.name, args.length)
        number = self.uploads.begin(args.name, args.dtype, args.length, args.crc)
        return verbs.TableState(upload=number, received=0)

    def do_table_chunk(self, args: verbs.TableChunk, by: str) -> verbs.TableState:
        received = self.uploads.chunk(args.upload, args.offset, args.data, args.crc)
        return verbs.TableState(upload=args.upload, received=received)

    def do_table_commit(self, args: verbs.TableCommit, by: str) -> m.Applied:
        name, array = self.uploads.finish(args.upload)
        sequence = self.runtime.write(self._shaped({name: array}), by, args.at_tick)
        if args.at_tick is not None and self.runtime.status().tick < args.at_tick:
            return m.Applied(sequence=sequence, tick=args.at_tick)  # it will be, then
        return applied(self.runtime, sequence)

    def _check_table(self, name: str, length: int) -> None:
        info = next((info for info in self.runtime.variables() if info.name == name), None)
        if info is None:
            raise VariableError(f"{name}: no such variable in the running code")
        if info.length < length:
            raise VariableError(f"{name}: {length} elements do not fit into {info.length}")
        if length % info.columns:
            raise VariableError(
                f"{name}: {length} elements are no whole number of rows of {info.columns}"
            )


def fade_of(runtime: RuntimeApi, seconds: float) -> int:
    """The number of samples of a fade; 0 while nothing runs.

    Raises
    ------
    Refused
        Too long, or no time at all.
    """
    if not 0.0 <= seconds <= LONGEST_FADE_S:
        raise Refused(f"a fade of {seconds:g} s: give 0 … {LONGEST_FADE_S:g} s")
    status = runtime.status()
    return round(seconds * status.rate_hz) if status.state == ProgramState.RUNNING else 0


def applied(runtime: RuntimeApi, sequence: int) -> m.Applied:
    """The reply to an update, once it is in effect. Where that takes long, another thread sends it.
    """
    return m.Applied(sequence=sequence, tick=applied_at(runtime, sequence))


def applied_at(runtime: RuntimeApi, sequence: int) -> int:
    """The sample at which an update took effect.

    Raises
    ------
    Later
        That takes long: the rest is for another thread.
    """
    try:
        return runtime.wait_applied(sequence, APPLY_INLINE_S)
    except NotYet:
        raise Later(
            lambda: m.Applied(
                sequence=sequence, tick=runtime.wait_applied(sequence, APPLY_LIMIT_S)
            )
        ) from None


def _light(info: m.VariableInfo) -> m.VariableInfo:
    """The variable, with its initial value shortened where it is a large array of one value: a
    table of zeros is not worth megabytes.
    """
    initial = info.initial
    if (
        isinstance(initial, np.ndarray)
        and initial.size > values.LIST_LIMIT
        and bool((initial == initial[0]).all())
    ):
        return msgspec.structs.replace(info, initial=initial[0].item())
    return info
