"""The settings of a runner: rate, clock, scheduling, watchdog. They are checked here, and read from
text where a command line gives them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from zendsp_protocol.errors import Refused
from zendsp_protocol.states import Clock

_TRUE, _FALSE = ("true", "yes", "on", "1"), ("false", "no", "off", "0")
MOST_MB = 1e9  # a thousand terabytes: more has no meaning
SPIN_US = 60.0  # waited awake where a loop has its CPU for itself


@dataclass(frozen=True)
class Settings:
    """How a runner runs.

    Parameters
    ----------
    machine : str
        Name of a shipped machine, or path of a ``.c`` file.
    machine_config : mapping
        Handed to the machine as lines ``key = value``.
    rate_hz : float
        Samples a second, 1 … 100 000.
    clock : str
        ``"real"`` or ``"fast"``.
    realtime : bool
        Ask for SCHED_RR, locked memory and a CPU of its own.
    priority : int
        Of SCHED_RR, 1 … 99.
    cpu : int
        CPU of the loop, -1: the last one on which no other loop of this user runs.
    spin_us : float
        Stretch before each deadline that is waited awake (only under SCHED_RR, at most 0.6 of the
        period), µs; -1: 60, or 0 on a CPU where another loop waits so.
    speed : float
        Fast clock: at most so many machine seconds a second; 0: no limit.
    hang_s : float
        A sample that does not return within so many seconds ends the runner.
    load_s : float
        UserInit that does not return within so many seconds ends the runner.
    memory_mb : float
        That user code may take beside what the machine has, shared memory aside, 50 MB or more;
        beyond it `malloc` returns NULL.
    """

    machine: str
    machine_config: Mapping[str, str | float]
    rate_hz: float = 1000.0
    clock: str = "real"
    realtime: bool = True
    priority: int = 80
    cpu: int = -1
    spin_us: float = -1.0
    speed: float = 0.0
    hang_s: float = 1.0
    load_s: float = 10.0
    memory_mb: float = 1000.0

    def __post_init__(self) -> None:
        if not 1.0 <= self.rate_hz <= 100_000.0:
            raise Refused(f"rate {self.rate_hz:g} Hz: give 1 … 100000 Hz")
        if self.clock not in list(Clock):
            raise Refused(f"clock {self.clock!r}: give 'real' or 'fast'")
        if not 1 <= self.priority <= 99:
            raise Refused(f"priority {self.priority}: SCHED_RR has 1 … 99")
        if not 50.0 <= self.memory_mb <= MOST_MB:
            raise Refused(
                f"{self.memory_mb:g} MB for user code: give 50 or more, {MOST_MB:g} at most"
            )
        if not self.speed >= 0.0:
            raise Refused(f"speed {self.speed:g}: give 0 (no limit) or more")
        if not (self.hang_s > 0.0 and self.load_s > 0.0):
            raise Refused(
                f"hang_s = {self.hang_s:g}, load_s = {self.load_s:g}: give times above 0 s, after"
                " which a program that hangs is ended"
            )
        for key, value in self.machine_config.items():
            if "\n" in f"{key}{value}" or "=" in key:
                raise Refused(f"machine setting {key!r}: neither newline nor '=' may be in it")


def split_options(options: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Split the options of a command line into fields of `Settings`, as text or as values, and
    settings ``machine.KEY`` of the machine.

    Returns
    -------
    settings : dict
        Fields of Settings, of their types.
    machine : dict
        What goes to the machine, without the prefix.

    Raises
    ------
    Refused
        No such option, or a value that cannot be read.

    Examples
    --------
    >>> split_options({"spin_us": "0", "machine.q1": "0.3"})
    ({'spin_us': 0.0}, {'q1': '0.3'})
    """
    known = {
        f.name: f.default
        for f in fields(Settings)
        if f.name not in ("machine", "machine_config", "rate_hz", "clock")
    }
    settings: dict[str, Any] = {}
    machine: dict[str, Any] = {}
    for name, value in options.items():
        if name.startswith("machine."):
            machine[name.removeprefix("machine.")] = value
        elif name not in known:
            raise Refused(
                f"no option {name!r}: there are {', '.join(known)}, concealed, and machine.KEY"
            )
        else:
            settings[name] = _converted(name, value, known[name])
    return settings, machine


def _converted(name: str, value: object, default: object) -> object:
    text = str(value).strip().lower()
    try:
        if isinstance(default, bool):
            if text not in (*_TRUE, *_FALSE):
                raise ValueError
            return text in _TRUE
        return int(text) if isinstance(default, int) else float(text)
    except ValueError:
        kind = "true or false" if isinstance(default, bool) else "a number"
        raise Refused(f"option {name} = {value!r}: give {kind}") from None
