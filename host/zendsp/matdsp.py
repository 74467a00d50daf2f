"""The MatDSP verbs: a control engineer's handful of functions, each one call, on one target at a
time.

    MatDSPconnect("imi")
    MatDSPdownload("pd.c"); MatDSPstart()
    MatDSPvariable("Kp1")                      # reads, now
    MatDSPvariable("Kp1", 450.0)               # notes the new value …
    MatDSPvariable("Kd1", 40.0)
    MatDSPupdate()                             # … and both take effect at the start of one sample
    MatDSPAcquireConfig({"channels": ["q", "tau"], "seconds": 2.0})
    rec = MatDSPAcquireLoad()

A value written with ``now=True`` does not wait for ``MatDSPupdate``. ``MatDSPdiscard`` forgets what
was noted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from zendsp.errors import AcquisitionError, CompileFailed, LinkError
from zendsp.link import Target, Trigger, connect
from zendsp.link.wait_recorded import ENDED
from zendsp.recording import Recording
from zendsp_isr.sources import Source
from zendsp_protocol import messages as m
from zendsp_protocol.states import ProgramState
from zendsp_protocol.values import Assignable


def _program(source: Source) -> Source:
    """The source itself; a target in its place is refused with what to write."""
    if isinstance(source, Target):
        raise CompileFailed(
            "a target stands where the C file belongs: MatDSPconnect(target) chooses it once, then"
            " MatDSPcompile(file)"
        )
    return source


class _Desk:
    """The one target that the verbs speak to."""

    target: Target | None = None
    configured: Target | None = None  # of which the last acquisition is this session's

    def get(self) -> Target:
        if self.target is None or self.target.link.closed:
            raise LinkError("no target is connected: call MatDSPconnect(name) first")
        return self.target


_desk = _Desk()
_ACQUIRE = ("channels", "seconds", "decimation", "trigger", "continuous", "take")


def MatDSPconnect(name: str | Target = "", endpoint: str | None = None) -> Target:
    """Choose the target for all other verbs: by name, or one that is open already.

    Parameters
    ----------
    name : str or Target
        May be left out where only one target runs on this machine.
    endpoint : str, optional
        Where it is, for example ``"tls/robot.lab:7447"``; see :func:`zendsp.connect`.

    Returns
    -------
    Target

    Raises
    ------
    LinkError
        No such target, or nothing answers.
    """
    _desk.target = name if isinstance(name, Target) else connect(name, endpoint)
    return _desk.target


def MatDSPclose() -> None:
    """End the connection; the target goes on."""
    if _desk.target is not None:
        _desk.target.close()
    _desk.target = None


def MatDSPcompile(source: Source, flags: Sequence[str] = ()) -> m.CompileResult:
    """Compile C code on the target.

    Parameters
    ----------
    source : path, or mapping of file name to text
        A C file (the headers beside it are sent too), or one of the shipped programs by its name.
    flags : sequence of str
        Further flags for the compiler.

    Returns
    -------
    CompileResult

    Raises
    ------
    CompileFailed
        With file, line and column of each message.
    """
    program = _program(source)
    return _desk.get().compile(program, flags)


def MatDSPdownload(source: Source, flags: Sequence[str] = ()) -> m.CompileResult:
    """Compile C code and load it; nothing moves before :func:`MatDSPstart`.

    Parameters
    ----------
    source, flags : as for :func:`MatDSPcompile`

    Returns
    -------
    CompileResult

    Raises
    ------
    CompileFailed
        With file, line and column of each message; what was loaded before stays.
    """
    program = _program(source)
    return _desk.get().download(program, flags)


def MatDSPstart() -> None:
    """Start the loaded program."""
    _desk.get().start()


def MatDSPpause() -> None:
    """Pause the program; outputs are safe."""
    _desk.get().pause()


def MatDSPstop() -> m.Status:
    """STOP: outputs are safe from the next sample on, latched; raises where the target does not say
    that it stopped.
    """
    return _desk.get().stop()


def MatDSPacknowledge() -> str:
    """Acknowledge a STOP or a trip, and say what was done; nothing moves before
    :func:`MatDSPstart`.
    """
    return _desk.get().acknowledge()


def MatDSPvariable(name: str, value: Any = None, now: bool = False) -> Any:
    """Read a variable of the running code, or note a new value for it.

    Parameters
    ----------
    name : str
    value : number, bool or array, optional
        Left out: read. Given: staged until :func:`MatDSPupdate`.
    now : bool
        Write at once instead, asynchronously.

    Returns
    -------
    number, bool or ndarray
        The value read, or the value given.

    Raises
    ------
    VariableError
        Unknown, read only, of another type, outside its limits or NaN; nothing was written or
        noted.
    """
    target = _desk.get()
    if value is None:
        return target[name]
    if now:
        target[name] = value
    else:
        target.stage(**{name: value})
    return value


def MatDSPupdate() -> int:
    """Apply every noted value at the start of one sample, all or nothing; returns that sample.

    Raises
    ------
    VariableError
        Nothing is noted, or another program was loaded since and lacks a variable; what is noted
        stays, see :func:`MatDSPdiscard`.
    """
    return _desk.get().update()


def MatDSPdiscard() -> dict[str, Assignable]:
    """Forget every noted value, and return what was noted."""
    return _desk.get().discard()


def MatDSPAcquireConfig(params: Mapping[str, Any]) -> m.AcquireStatus:
    """Configure the acquisition and start (or arm) it. While the program is paused the recorder
    waits: the first row is the first sample after :func:`MatDSPstart`.

    Parameters
    ----------
    params : mapping
        ``channels`` and, where wanted, ``seconds``, ``decimation``, ``continuous``, ``take``, and
        ``trigger``: a mapping of ``source``, ``level``, ``edge``, ``pre_s``.
    """
    unknown = [name for name in params if name not in _ACQUIRE]
    if unknown or "channels" not in params:
        raise AcquisitionError(
            f"unknown or missing entries ({', '.join(unknown) or 'channels'}); known:"
            f" {', '.join(_ACQUIRE)}"
        )
    given = dict(params)
    if isinstance(given.get("trigger"), Mapping):
        given["trigger"] = Trigger(**given["trigger"])
    target = _desk.get()
    status = target.acquire_configure(**given)
    target.acquire_start()
    _desk.configured = target
    return status


def MatDSPAcquireLoad(timeout: float = 60.0) -> Recording:
    """Wait until the acquisition is complete (a continuous one: stop it) and load it.

    Parameters
    ----------
    timeout : float, s
        Of real time.

    Returns
    -------
    Recording

    Raises
    ------
    AcquisitionError
        Nothing was recorded, or not within the time; or no :func:`MatDSPAcquireConfig` of this
        session's came before.
    """
    target = _desk.get()
    if _desk.configured is not target:
        raise AcquisitionError(
            "nothing was configured here: MatDSPAcquireConfig({'channels': [...]}) first; what"
            " another host recorded, target.acquire_load() brings home"
        )
    if (
        target.status().state in (ProgramState.LOADED, ProgramState.PAUSED)
        and target.acquire_status().state not in ENDED
    ):
        raise AcquisitionError("no row comes while the program is paused: MatDSPstart() first")
    return target.acquire_finish(timeout=timeout)
