"""The eight streams of a target, by number; each stays readable after the program that filled it
has ended.
"""

from __future__ import annotations

import itertools
import logging
import os
import threading
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from zendsp_protocol import kept
from zendsp_protocol.errors import AcquisitionError
from zendsp_protocol.kept import About
from zendsp_protocol.messages import AcquireStatus, Held
from zendsp_protocol.states import RecorderState
from zendsp_target.api import RECORDER, AcquireConfig
from zendsp_target.runtime import acquisition
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.memory.shm import SharedFolder
from zendsp_target.runtime.session import Session

log = logging.getLogger(__name__)


class Recorder:
    """Streams by number: 0 the recorder, 1 … 7 live.

    Parameters
    ----------
    current : callable
        The session that runs now, None where there is none.
    """

    def __init__(self, folder: SharedFolder, current: Callable[[], Session | None]) -> None:
        self._folder, self._current = folder, current
        self._streams: dict[int, tuple[acquisition.Stream, Session]] = {}
        self._files = 0
        # of the rows of all streams; a target of the same name that is started anew has others
        self._begun = itertools.count(1 + int.from_bytes(os.urandom(4)))
        self._lock = threading.Lock()

    def configure(self, stream: int, config: AcquireConfig) -> AcquireStatus:
        """Set up a stream (0: the recorder; 1 … 7: live). The rows that it held before are dropped.

        Raises
        ------
        AcquisitionError
            No program, an unknown channel, or more than fits into memory.
        """
        _, lib = layout()
        if not 0 <= stream < lib.LAYOUT_STREAMS:
            raise AcquisitionError(f"stream {stream}: there are 0 … {lib.LAYOUT_STREAMS - 1}")
        with self._lock:
            session = self._current()
            if session is None or not session.alive():
                raise AcquisitionError(
                    "no program is loaded: load one before configuring an acquisition"
                )
            self._files += 1
            path = self._folder.path / f"stream-{stream}-{self._files}"
            fresh = acquisition.create(
                path, session.dictionary, config, session.settings.rate_hz,
                self._folder.free_bytes(), next(self._begun),
            )
            try:
                acquisition.attach(fresh, session.control, stream, session.alive)
            except BaseException:
                fresh.file.unlink()
                raise
            # both sides have it mapped: only what may be salvaged keeps its name
            (self._forget if stream == RECORDER else fresh.file.unlink)()
            self._streams[stream] = (fresh, session)
            return acquisition.status(fresh, True)

    def start(self, stream: int, force: bool = False) -> None:
        """Begin to acquire, or wait for the trigger. `force` fires the trigger of an armed stream.

        Raises
        ------
        AcquisitionError
            Not configured, or its program is no longer loaded.
        """
        found, session = self._stream(stream)
        if not self._fed(session):
            raise AcquisitionError(
                f"stream {stream} belongs to a program that is no longer loaded: configure it again"
            )
        if not (force and acquisition.status(found, True).state == RecorderState.ARMED):
            if found.started:
                found.begun = next(self._begun)
            found.started = True
            acquisition.request(found, "arm", session.alive)
        if force:
            acquisition.request(found, "force", session.alive)

    def keep(self, about: About) -> None:
        """Leave a note from which the recorder's rows can be salvaged if this process is killed;
        see `zendsp_protocol.kept`.
        """
        found, session = self._stream(RECORDER)
        if not self._fed(session):
            return
        try:
            kept.write(self._folder.path, acquisition.note_of(found, about))
        except OSError as error:  # shared memory is full; the recording has begun
            log.warning("what is recorded now is lost if the target is killed: %s", error)

    def _forget(self) -> None:
        """Remove the note on what the recorder held before."""
        (self._folder.path / kept.NOTE).unlink(missing_ok=True)
        if RECORDER in self._streams:
            self._streams[RECORDER][0].file.unlink()

    def stop(self, stream: int) -> None:
        """End an acquisition at the next sample; its rows stay."""
        found, session = self._stream(stream)
        if self._fed(session):
            acquisition.request(found, "disarm", session.alive)

    def status(self, stream: int) -> AcquireStatus:
        """The state of a stream and its counts of rows."""
        if stream not in self._streams:
            return AcquireStatus(RecorderState.IDLE)
        found, session = self._streams[stream]
        return acquisition.status(found, self._fed(session))

    def held(self, stream: int) -> Held:
        """The file in which the rows of a stream are; an empty path where the stream is not
        configured.
        """
        if stream not in self._streams:
            return Held()
        found, session = self._streams[stream]
        return acquisition.held(found, self._fed(session))

    def read(
        self,
        stream: int,
        first: int,
        count: int,
        into: npt.NDArray[np.float64] | None = None,
        fold: bytearray | None = None,
    ) -> npt.NDArray[np.float64]:
        """Rows of a stream, shape (rows, channels). See `acquisition.read`."""
        return acquisition.read(self._stream(stream)[0], first, count, into, fold)

    def _stream(self, stream: int) -> tuple[acquisition.Stream, Session]:
        found = self._streams.get(stream)
        if found is None:
            raise AcquisitionError(f"stream {stream} is not configured: configure it first")
        return found

    def _fed(self, session: Session) -> bool:
        return session is self._current() and session.alive()
