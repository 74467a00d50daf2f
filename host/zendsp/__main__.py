"""The command ``zendsp``, also as ``python -m zendsp``: Ctrl-C ends it quietly, also while it
loads, and is never lost.
"""

from __future__ import annotations

import sys

try:
    import atexit
    import os
    import signal
    from contextlib import suppress
except KeyboardInterrupt:
    sys.stderr.write("interrupted\n")
    raise SystemExit(130) from None

HELD = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}  # until the command can be ended by them
AGAIN_S = 0.05  # by then the main thread is elsewhere, perhaps in a call that only a signal ends


def main() -> None:
    """Import the commands and run the one that was typed."""
    signal.pthread_sigmask(signal.SIG_BLOCK, HELD)
    _open_streams()
    end = _End()
    from zendsp.tui.early import begin

    keys = begin(sys.argv[1:])  # first: F9 may be typed at any time
    from zendsp.cli import main as command
    from zendsp.here.ending import end_softly, interruption

    end_softly()
    sys.unraisablehook = _unraisable
    try:
        if not keys:  # else once STOP is in safe hands
            signal.pthread_sigmask(signal.SIG_UNBLOCK, HELD)  # what came meanwhile comes here
        command()
    except KeyboardInterrupt:
        words, status = interruption()
        sys.stderr.write(f"{words}\n")
        raise SystemExit(end.status_of(status)) from None
    except SystemExit as stop:
        end.status_of(stop.code)
        raise


class _End:
    """Ends the process once all exit handlers have run: after Ctrl-C by the signal itself, or a
    loop of a shell would go on. The interpreter's own end would abort it where one of Zenoh's
    threads returns from compiled code meanwhile ("exception not rethrown").
    """

    def __init__(self) -> None:
        self.status = 1  # of an error that nobody expected
        atexit.register(self._leave)  # the first: it runs last

    def status_of(self, code: object) -> int:
        """Note the exit status that a ``SystemExit`` with this code means, and return it."""
        self.status = code if isinstance(code, int) else int(code is not None)
        return self.status

    def _leave(self) -> None:
        interrupted = self.status == 128 + signal.SIGINT
        if interrupted or "zenoh" in sys.modules:
            for stream in (sys.stdout, sys.stderr):
                with suppress(OSError):  # nobody reads it any more
                    stream.flush()
            if interrupted:
                signal.signal(signal.SIGINT, signal.SIG_DFL)
                signal.raise_signal(signal.SIGINT)
            os._exit(self.status)


def _open_streams() -> None:
    """Have standard streams that were closed (``>&-``) lead nowhere: the next file that is opened
    would be taken for them.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # takes the lowest number
        if getattr(sys, name) is None:
            setattr(sys, name, open(number, "r" if number == 0 else "w"))  # noqa: SIM115


def _unraisable(unraisable: sys.UnraisableHookArgs) -> None:
    """Python drops a Ctrl-C that comes while an object is taken apart: have it come again."""
    if issubclass(unraisable.exc_type, KeyboardInterrupt):
        import threading

        main_thread = threading.main_thread().ident
        threading.Timer(AGAIN_S, signal.pthread_kill, (main_thread, signal.SIGINT)).start()
    else:
        sys.__unraisablehook__(unraisable)


if __name__ == "__main__":
    main()
