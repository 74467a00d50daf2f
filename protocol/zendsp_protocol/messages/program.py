"""A program: compiled, loaded, its variables read and written."""

from __future__ import annotations

from zendsp_protocol.messages.base import Message
from zendsp_protocol.states import Severity, VariableKind
from zendsp_protocol.texts import placed
from zendsp_protocol.values import WireValue


class Diagnostic(Message, frozen=True):
    """One message of the compiler."""

    severity: Severity  # error, warning or note
    file: str  # as the host named it
    line: int  # from 1; 0 where the compiler gives none
    column: int  # from 1; 0 where there is none, as of the linker
    message: str  # the compiler's own words

    def __str__(self) -> str:
        words = f"{self.severity}: {self.message}"
        return placed(self.file, self.line, self.column, words) if self.line else words


class CompileResult(Message, frozen=True):
    """Outcome of ``compile``."""

    ok: bool  # whether there is a program to load
    key: str  # content hash of source, header, flags and compiler; for load
    diagnostics: tuple[Diagnostic, ...] = ()  # in the user's own files
    seconds: float = 0.0  # s, spent
    cached: bool = False  # whether it was compiled before
    compiler: str = ""  # path and version
    flags: tuple[str, ...] = ()  # all that were used

    def __repr__(self) -> str:
        cached = " (from the cache)" if self.cached else ""
        parts = [f"ok in {self.seconds:.2g} s{cached}" if self.ok else "not compiled"]
        parts += map(str, self.diagnostics)
        return f"<CompileResult {'; '.join(parts)}>"


class VariableInfo(Message, frozen=True):
    """One entry of the dictionary of the running code."""

    name: str  # as in the C code
    type: str  # double, float, int32 or bool
    length: int = 1  # elements; 1 for a scalar
    # parameter (may be written), signal (read only), table (large) or builtin
    kind: VariableKind = VariableKind.PARAMETER
    unit: str = ""  # as declared
    minimum: float = float("-inf")  # -inf where there is none
    maximum: float = float("inf")  # inf where there is none
    # value after UserInit; a table of one value throughout is sent as that value
    initial: WireValue = 0.0
    description: str = ""  # as declared
    address: int = 0  # bytes within the program's image
    columns: int = 1  # of a table or matrix: values a row; length counts all values


class Change(Message, frozen=True):
    """One line of the parameter log."""

    tick: int  # sample at which it took effect
    host_time: float  # Unix s, by the target's clock
    name: str  # of the parameter
    old: WireValue  # value before
    new: WireValue  # value after
    author: str  # who asked
    fade: int = 0  # samples over which it came; `tick` is then that of its end


class Reading(Message, frozen=True, kw_only=True):
    """Values of several variables, all from one sample."""

    tick: int  # the sample
    values: dict[str, WireValue]  # by name
    # why the program no longer runs (crash, trip, STOP): the values are those of its last sample
    ended: str = ""


class Written(Message, frozen=True, kw_only=True):
    """A write was accepted; it takes effect at the start of a sample."""

    sequence: int  # for wait_applied


class Applied(Message, frozen=True, kw_only=True):
    """A write took effect at the start of sample ``tick``."""

    sequence: int  # of the update
    tick: int  # sample at whose start it took effect


class Program(Message, frozen=True, kw_only=True):
    """The loaded program, as it was sent."""

    key: str = ""  # of the loaded program
    sources: dict[str, str] = {}  # file name to text, as they were sent
    flags: tuple[str, ...] = ()  # for the compiler
    compiler: str = ""  # path and version
    log_start: int = 0  # lines of the parameter log from before it was loaded

    def __repr__(self) -> str:
        files = (f"{name} ({text.count(chr(10))} lines)" for name, text in self.sources.items())
        return f"<Program {', '.join(files) or 'none'}; {self.compiler or 'no compiler known'}>"
