"""A target's signals for the Rerun viewer, live or into its file."""

from __future__ import annotations

import socket
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from zendsp.bridge.foxglove import columns_of
from zendsp.errors import LinkError
from zendsp.extras import need
from zendsp.link import Target
from zendsp.link.live import LiveBlock
from zendsp_protocol.states import VariableKind

PORT = 9876  # where a viewer listens
# between blocks: each costs Rerun 2 kB a channel, one row as much as twenty
LIVE_S = 0.05
FILE_S = 0.2


def _viewer_listens() -> bool:
    try:
        socket.create_connection(("127.0.0.1", PORT), 1.0).close()
    except OSError:
        return False
    return True


@contextmanager
def rerun(
    target: Target,
    channels: Sequence[str] = (),
    *,
    rate: float = 100.0,
    save: str | Path | None = None,
) -> Iterator[None]:
    """Show the loaded program's signals in Rerun, until the ``with`` block ends.

    Parameters
    ----------
    target : Target
    channels : sequence of str
        Signals to show; default all signals of the program.
    rate : float, Hz
        Rows a second at the most.
    save : path, optional
        Into this ``.rrd`` file; without it, to the viewer that runs on this computer. None is
        started: by itself a viewer would listen to every computer.

    Raises
    ------
    LinkError
        rerun-sdk is not installed, there is no viewer, the file cannot be written, or the program
        has no signals.

    Examples
    --------
    >>> from zendsp.bridge import rerun
    >>> with rerun(target, ["q"], save="run.rrd"):  # doctest: +SKIP
    ...     target.wait("paused")
    """
    rr = need("rerun", "rerun", "the bridge", LinkError)
    infos = target.variables()
    wanted = list(channels) or [n for n, i in infos.items() if i.kind == VariableKind.SIGNAL]
    if not wanted:
        raise LinkError(f"{target.name} has a program without signals: there is nothing to show")
    if save is None and not _viewer_listens():
        raise LinkError(
            f"no Rerun viewer listens on port {PORT} of this computer: 'rerun --bind 127.0.0.1'"
            " starts one, or save a file (--save run.rrd)"
        )
    recording = rr.RecordingStream(f"zendsp {target.name}")
    if save is None:
        recording.connect_grpc(f"rerun+http://127.0.0.1:{PORT}/proxy")
    else:
        try:
            recording.save(save)
        except RuntimeError as error:
            raise LinkError(f"{save}: cannot be written ({error})") from error
    columns = [(rr.escape_entity_path_part(n), part) for n, part, _ in columns_of(wanted, infos)]

    def rows(block: LiveBlock) -> None:
        time = rr.TimeColumn("t", duration=block.t)
        for name, part in columns:
            values = rr.Scalars.columns(scalars=block.data[:, part])
            rr.send_columns(name, [time], values, recording=recording)

    every = max(1, round(target.status().rate_hz / rate))
    interval = LIVE_S if save is None else FILE_S
    view = target.live(
        wanted, decimation=every, interval=interval, history=0.1, callback=rows
    )
    try:
        yield
    finally:
        view.close()
        recording.flush()
        recording.disconnect()
