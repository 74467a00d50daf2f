"""The command ``zendsp``, also as ``python -m zendsp``: Ctrl-C ends it quietly, also while it
loads, and is never lost.
"""

from __future__ import annotations

import sys

try:
    import os
    import signal
except KeyboardInterrupt:
    raise SystemExit(130) from None

AGAIN_S = 0.05  # by then the main thread is elsewhere, perhaps in a call that only a signal ends


def main() -> None:
    """Import the commands and run the one that was typed."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    _open_streams()
    from zendsp.cli import main as command

    sys.unraisablehook = _unraisable
    try:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)  # a Ctrl-C meanwhile comes here
        command()
    except KeyboardInterrupt:
        raise SystemExit(130) from None


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
