"""Restores what a run has set in the program, when the run ends or its host is lost."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass

from zendsp_protocol import messages as m
from zendsp_protocol import verbs
from zendsp_protocol.errors import Refused, VariableError, ZendspError
from zendsp_protocol.states import HostLost, ProgramState, VariableKind
from zendsp_protocol.values import Value
from zendsp_target.api import RuntimeApi
from zendsp_target.serving.drives import Drives
from zendsp_target.serving.variable_verbs import applied, fade_of

log = logging.getLogger(__name__)

GONE = (ProgramState.CRASHED, ProgramState.EMPTY)
FOLLOW = "use_table"  # parameter of programs that follow a table only where it is set
MOST = 64  # runs of one host that may be open
STANDS_S = 1.0  # for the host-lost policy to act


@dataclass(frozen=True)
class Run:
    """A run that has begun, and the values before it."""

    host: str
    moves: bool
    values: Mapping[str, Value]
    tables: frozenset[str]
    before: m.Status
    follows: bool  # the program followed its table
    fade: float  # s, over which it is put back while the program runs


class Runs:
    """Handlers of ``run_begin`` and ``run_end``, and what happens to runs whose host is lost.

    Parameters
    ----------
    drives : Drives
        Whose host-lost policy decides where a run moves the machine.
    """

    def __init__(self, runtime: RuntimeApi, drives: Drives) -> None:
        self._runtime, self._drives = runtime, drives
        self._open: dict[int, Run] = {}
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()

    def do_run_begin(self, args: verbs.RunBegin, by: str) -> m.RunBegun:
        infos = {info.name: info for info in self._runtime.variables()}
        names = [name for name in args.names if name.partition("[")[0] in infos]
        values = self._runtime.read(names)[1] if names else {}
        signals = [n for n in names if infos[n.partition("[")[0]].kind == VariableKind.SIGNAL]
        if signals:
            raise Refused(f"a run sets parameters and tables, no signals: {', '.join(signals)}")
        tables = frozenset(n for n in names if n in infos and infos[n].kind == VariableKind.TABLE)
        follows = FOLLOW not in infos or bool(self._runtime.read([FOLLOW])[1][FOLLOW])
        fade_of(self._runtime, args.fade)  # refuses one that is too long
        run = Run(by, args.moves, values, tables, self._runtime.status(), follows, args.fade)
        with self._lock:
            if sum(other.host == by for other in self._open.values()) >= MOST:
                raise Refused(f"{MOST} of your runs are open: end one")
            number = next(self._numbers)
            self._open[number] = run
            self._tell()
        return m.RunBegun(run=number, names=tuple(names), follows=follows)

    def do_run_end(self, args: verbs.RunEnd, by: str) -> m.Applied:
        """End a run, also where another host commands: what it set then stays, which is refused
        after it has ended, or the loss of its host would stop what the other one does.
        """
        with self._lock:
            run = self._open.get(args.run)
            if run is not None and run.host != by:
                raise Refused(f"run {args.run} is ended by its own host, {run.host}")
            self._open.pop(args.run, None)
            self._tell()
        if self._drives.commander:
            self._drives.check_right(by)
        sequence = self._put_back(run, by) if run is not None else 0
        return applied(self._runtime, sequence) if sequence else m.Applied(sequence=0, tick=0)

    def host_gone(self, host: str) -> None:
        """Apply the host-lost policy if a run of a lost host moves the machine; then restore what
        its runs have set, the last run first.
        """
        with self._lock:
            mine = [number for number, run in self._open.items() if run.host == host]
            runs = [self._open.pop(number) for number in reversed(mine)]
            self._tell()
        moves = any(run.moves for run in runs)
        policy = self._drives.host_gone(host, moves)
        if (moves and policy == HostLost.FINISH) or self._drives.commander not in ("", host):
            return  # it goes on as it was set, or somebody else commands the machine now
        if runs:
            self._runtime.cancel(lambda author: author == host)
        deadline = time.monotonic() + STANDS_S
        while policy == HostLost.STOP and self._moves() and time.monotonic() < deadline:
            time.sleep(0.002)
        for run in runs:
            try:
                self._put_back(run, f"{host}, lost")
            except ZendspError as error:
                log.warning("what %s had set stays: %s", host, error)

    def _tell(self) -> None:
        self._drives.moved_by = next((r.host for r in self._open.values() if r.moves), "")

    def _moves(self) -> bool:
        status = self._runtime.status()
        return status.state == ProgramState.RUNNING and status.trip is None

    def _put_back(self, run: Run, by: str) -> int:
        """Restore all values in one sample, or faded over several where the run asked for it and
        the program runs; return the sequence number of the update, 0 where there was none.

        Nothing is written into a program other than the run's, one that was loaded anew, or one
        that crashed. The rows of tables are not restored while the program runs and follows its
        tables, since the switch-over would start their motion.
        """
        now, then = self._runtime.status(), run.before
        if now.state in GONE or now.program != then.program or now.tick < then.tick:
            return 0
        follows = run.follows and self._moves()
        values = {
            name: value
            for name, value in run.values.items()
            if not (follows and name in run.tables and len(value))  # type: ignore[arg-type]
        }
        fade = fade_of(self._runtime, run.fade)
        return self._write(values, by, fade)

    def _write(self, values: Mapping[str, Value], by: str, fade: int) -> int:
        """Write the values that may be written. Values that the program itself had set are not held
        to limits.
        """
        if not values:
            return 0
        try:
            return self._runtime.write(values, by, None, fade)
        except VariableError as error:
            fit = {name: value for name, value in values.items() if self._fits(name, value)}
            if not 0 < len(fit) < len(values):
                raise
            self._runtime.write(fit, by, None, fade)
            raise VariableError(f"{error}; put back: {', '.join(fit)}") from error

    def _fits(self, name: str, value: Value) -> bool:
        try:
            self._runtime.check({name: value})
        except VariableError:
            return False
        return True
