"""The one tree of errors that zendsp raises.

    ZendspError
    ├── LinkError (ConnectionError)        the link: no target, no answer, wrong version
    │   ├── NoAnswer (TimeoutError)
    │   │   └── NotApplied                 certainly not: it may be sent anew
    │   ├── NotStopped                     STOP was asked and nothing says that the machine stands
    │   └── VersionMismatch
    ├── Refused (RuntimeError)             the target says no, and why
    │   ├── TooSoon                        not yet: what was sent before is not in effect
    │   └── Unmeasured                     what was recorded of one joint is no measurement
    ├── Tripped (RuntimeError)             a STOP, a limit or a fault ended a program at its start
    ├── NotYet (TimeoutError)              accepted, and still waiting for its sample
    ├── VariableError (ValueError)         unknown name, wrong type, outside limits, NaN; one line per variable
    ├── CompileFailed (RuntimeError)       the user's C code: file, line, column of each message
    ├── RunnerDied (RuntimeError)          user code crashed or hung; signal and last sample
    ├── AcquisitionError (RuntimeError)    no such channel, nothing acquired, data lost
    │   ├── TooLarge                       more than the memory of the target holds
    │   └── Incomplete                     it ended early: acquire_load() brings home what there is
    ├── RecordingError (ValueError)        a file or a table that is not a recording
    ├── ModelError (ValueError)            a model file: which key, what was expected
    └── ReferenceError_ (ValueError)       a reference outside the machine's limits or badly posed

Every message names what, the value, the limit and what to do next.
"""  # noqa: E501

from __future__ import annotations

from collections.abc import Collection
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zendsp_protocol.messages import CompileResult


def nearest(name: str, known: Collection[str], most: int = 1, alike: float = 0.6) -> list[str]:
    """The known names that somebody who wrote ``name`` may have meant, the most similar first; case
    does not count.

    Parameters
    ----------
    name : str
        As it was written.
    known : collection of str
        What could stand there.
    most : int
        So many at the most.
    alike : float
        How alike they must be, 0 … 1.

    Examples
    --------
    >>> nearest("kd1", ("qd1", "Kd1"), 2)
    ['Kd1', 'qd1']
    """
    import difflib

    small = {word.lower(): word for word in known}
    return [small[word] for word in difflib.get_close_matches(name.lower(), small, most, alike)]


def did_you_mean(name: str, known: Collection[str]) -> str:
    """A sentence on what ``name`` was probably meant to be, and on the names that exist.

    Parameters
    ----------
    name : str
        As it was written.
    known : collection of str
        What could stand there.

    Examples
    --------
    >>> did_you_mean("dealy", ("gain", "delay"))
    'did you mean delay? Allowed: gain, delay'
    """
    close = nearest(name, known)
    return (
        f"{f'did you mean {close[0]}? Allowed' if close else 'allowed'}:"
        f" {', '.join(known) or 'none'}"
    )


OWN = ("zendsp", "zendsp_protocol", "zendsp_target", "zendsp_isr")  # packages


class ZendspError(Exception):
    """Root of every error that zendsp raises on purpose."""

    def _render_traceback_(self) -> list[str]:
        """What IPython shows, line by line: the user's own lines, and what is wrong."""
        import traceback

        own = []
        for frame, line in traceback.walk_tb(self.__traceback__):
            package = str(frame.f_globals.get("__name__", "")).partition(".")[0]
            if package in OWN:
                break
            if package != "IPython":
                own.append((frame, line))
        said = [f"{type(self).__name__}: {self}", *getattr(self, "__notes__", ())]
        return [each.rstrip() for each in traceback.StackSummary.extract(iter(own)).format()] + said


class LinkError(ZendspError, ConnectionError):
    """The link does not reach a target."""


class NoAnswer(LinkError, TimeoutError):
    """A request was sent and nothing came back in time."""


class NotStopped(LinkError):
    """STOP was asked, and no word came that the machine stopped: use its own emergency stop."""


class NotApplied(NoAnswer):
    """A request was not applied, and will not be: it did not reach the target in time."""


class VersionMismatch(LinkError):
    """Host and target speak different versions of the protocol."""


class Refused(ZendspError, RuntimeError):
    """The target understood the request and declines it; the message says which condition fails."""


class TooSoon(Refused):
    """What was sent before is not in effect yet; the same request may be made again."""


class Unmeasured(Refused):
    """What an experiment recorded of one joint is no measurement; others may still be measured."""


class Tripped(ZendspError, RuntimeError):
    """A program was started, and a STOP, a limit or a fault ended it in its first samples."""


class NotYet(ZendspError, TimeoutError):
    """An update was accepted, and its sample has not come."""


class VariableError(ZendspError, ValueError):
    """One or more variables were named, typed or valued wrongly; nothing was applied."""


class EndedWarning(UserWarning):
    """A value was read of a program that no longer runs: it crashed, tripped or was stopped."""


class CompileFailed(ZendspError, RuntimeError):
    """The C code did not compile; ``result`` holds what the compiler said of each place."""

    result: CompileResult | None = None


class RunnerDied(ZendspError, RuntimeError):
    """User code crashed or never returned; the runner is gone, the target lives on."""


class AcquisitionError(ZendspError, RuntimeError):
    """An acquisition cannot be configured, filled or loaded as asked."""


class TooLarge(AcquisitionError):
    """An acquisition needs more memory than the target gives."""


class Incomplete(AcquisitionError):
    """A recording ended before it had all its rows; ``acquire_load`` brings home those it has."""


class RecordingError(ZendspError, ValueError):
    """A file or table is not a usable recording."""


class ModelError(ZendspError, ValueError):
    """A model file is not what docs/diagnosis.md describes."""


class ReferenceError_(ZendspError, ValueError):
    """A reference cannot be planned or breaks a limit of the machine."""
