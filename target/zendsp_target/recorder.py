"""The eight streams of a target, by number; each stays readable after the program that filled it is
gone.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from zendsp_protocol import kept
from zendsp_protocol.errors import AcquisitionError
from zendsp_protocol.kept import About
from zendsp_protocol.messages import Held
from zendsp_protocol.states import RecorderState
from zendsp_target import acquisition
from zendsp_target.api import RECORDER, AcquireConfig, AcquireStatus
from zendsp_target.layout import layout
from zendsp_target.session import Session
from zendsp_target.shm import SharedFolder


class Recorder:
    """Streams by number: 0 the recorder, 1 … 7 live.

    Parameters
    ----------
    folder : SharedFolder
    current : callable
        The session that runs now, None where there is none.
    """

    def __init__(self, folder: SharedFolder, current: Callable[[], Session | None]) -> None:
        self._folder, self._current = folder, current
        self._streams: dict[int, tuple[acquisition.Stream, Session]] = {}
        self._files = 0
        self._lock = threading.Lock()

    def configure(self, number: int, config: AcquireConfig) -> AcquireStatus:
        """Set up a stream; see `Runtime.acquire_configure`."""
        _, lib = layout()
        if not 0 <= number < lib.LAYOUT_STREAMS:
            raise AcquisitionError(f"stream {number}: there are 0 … {lib.LAYOUT_STREAMS - 1}")
        with self._lock:
            session = self._current()
            if session is None or not session.alive():
                raise AcquisitionError(
                    "no program is loaded: load one before configuring an acquisition"
                )
            self._files += 1
            path = self._folder.path / f"stream-{number}-{self._files}"
            fresh = acquisition.create(
                path,
                session.dictionary,
                config,
                session.settings.rate_hz,
                self._folder.free_bytes(),
            )
            try:
                acquisition.attach(fresh, session.control, number, session.alive)
            except BaseException:
                fresh.file.unlink()
                raise
            # both sides have it mapped: only what may be salvaged keeps its name
            (self._forget if number == RECORDER else fresh.file.unlink)()
            self._streams[number] = (fresh, session)
            return acquisition.status(fresh, True)

    def start(self, number: int, force: bool) -> None:
        """Arm a stream, or fire the trigger of one that is armed."""
        found, session = self._stream(number)
        if not self._fed(session):
            raise AcquisitionError(
                f"stream {number} belongs to a program that is no longer loaded: configure it again"
            )
        if not (force and acquisition.status(found, True).state == RecorderState.ARMED):
            acquisition.request(found, "arm", session.alive)
        if force:
            acquisition.request(found, "force", session.alive)

    def keep(self, about: About) -> None:
        """Leave word of what the recorder holds, for the case that this process is killed."""
        found, session = self._stream(RECORDER)
        if self._fed(session):
            kept.write(self._folder.path, acquisition.note_of(found, about))

    def _forget(self) -> None:
        """What the recorder held before is not to be salvaged."""
        (self._folder.path / kept.NOTE).unlink(missing_ok=True)
        if RECORDER in self._streams:
            self._streams[RECORDER][0].file.unlink()

    def stop(self, number: int) -> None:
        """End an acquisition at the next sample."""
        found, session = self._stream(number)
        if self._fed(session):
            acquisition.request(found, "disarm", session.alive)

    def status(self, number: int) -> AcquireStatus:
        """Where a stream stands."""
        if number not in self._streams:
            return AcquireStatus(RecorderState.IDLE, (), (), 1, 0, 0, 0, 0, 0, -1)
        found, session = self._streams[number]
        return acquisition.status(found, self._fed(session))

    def held(self, number: int) -> Held:
        """Where the rows of a stream stand; an empty path where it is not configured."""
        if number not in self._streams:
            return Held()
        found, session = self._streams[number]
        return acquisition.held(found, self._fed(session))

    def read(
        self,
        number: int,
        first: int,
        count: int,
        into: npt.NDArray[np.float64] | None = None,
        fold: bytearray | None = None,
    ) -> npt.NDArray[np.float64]:
        """Rows of a stream, shape (rows, channels)."""
        return acquisition.read(self._stream(number)[0], first, count, into, fold)

    def _stream(self, number: int) -> tuple[acquisition.Stream, Session]:
        found = self._streams.get(number)
        if found is None:
            raise AcquisitionError(f"stream {number} is not configured: configure it first")
        return found

    def _fed(self, session: Session) -> bool:
        return session is self._current() and session.alive()
