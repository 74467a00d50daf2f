"""On which CPU each loop of this user runs and how long it waits awake. Each has a CPU of its own
while there are enough; where loops share a CPU, only the first one on it waits awake.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
from dataclasses import replace

from zendsp_target.runtime.process.settings import SPIN_US, Settings

_MOST = 1000  # loops of one user


class Place:
    """The number of a loop among those of this user on this computer: the smallest that is free. It
    is a lock on a file, so that a process that dies gives it back.

    Parameters
    ----------
    folder : str, optional
        Of the files; default: one of this user in shared memory.
    """

    def __init__(self, folder: str = "") -> None:
        self.number, self._file = 0, -1
        folder = folder or f"/dev/shm/loops-of-zendsp-{os.getuid()}"
        with contextlib.suppress(OSError):  # without shared memory: as if it were the only one
            os.makedirs(folder, 0o700, exist_ok=True)
            if os.lstat(folder).st_uid == os.getuid():
                self._take(folder)

    def _take(self, folder: str) -> None:
        for number in range(_MOST):
            file = os.open(f"{folder}/{number}", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(file)
            else:
                self.number, self._file = number, file
                return

    def close(self) -> None:
        """Give the number back."""
        if self._file >= 0:
            os.close(self._file)
            self._file = -1


def make_urgent(loop: int, settings: Settings) -> int:
    """Give a loop SCHED_RR and a CPU of its own, where the system permits it.

    Parameters
    ----------
    loop : int
        Its thread.

    Returns
    -------
    int
        0, or the errno with which SCHED_RR was refused.
    """
    # not SCHED_FIFO: there, a program that hangs keeps the CPU from every other target on it until
    # its watchdog ends it
    policy, priority = os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(settings.priority)
    try:
        os.sched_setscheduler(loop, policy, priority)
    except OSError as error:
        return error.errno or errno.EPERM
    with contextlib.suppress(OSError):
        allowed = os.sched_getaffinity(loop)
        if len(allowed) > 1:
            os.sched_setaffinity(loop, {settings.cpu if settings.cpu in allowed else max(allowed)})
    return 0


def placed(settings: Settings, place: Place) -> Settings:
    """The settings, with the CPU and the time awake filled in where they are left open.

    Parameters
    ----------
    place : Place
        Of this loop.
    """
    cpus = sorted(os.sched_getaffinity(0))
    # from the last CPU on: interrupts and most other work run on the first ones
    cpu = settings.cpu if settings.cpu >= 0 else cpus[-1 - place.number % len(cpus)]
    alone = place.number < len(cpus)
    spin_us = settings.spin_us if settings.spin_us >= 0.0 else SPIN_US if alone else 0.0
    return replace(settings, cpu=cpu, spin_us=spin_us)
