"""The Dask cluster that a scheduler's address names."""

from __future__ import annotations

import logging
import threading
import time
from typing import Any

from zendsp.errors import LinkError
from zendsp.extras import need

log = logging.getLogger(__name__)
ANSWER_S = 10.0  # a scheduler has to answer
LOOK_S = 10.0  # interval of checks on the workers


def connect(address: str) -> Any:
    """A client of the Dask scheduler at `address`, which has workers. When the last of them goes,
    the log says so: the tasks then wait for others.

    Parameters
    ----------
    address : str
        As ``"tcp://host:8786"``.

    Returns
    -------
    distributed.Client
        The caller closes it.

    Raises
    ------
    ZendspError
        ``distributed`` is not installed.
    LinkError
        The scheduler does not answer within 10 s, or has no workers.
    """
    dask = need("distributed", "fleet", "--scheduler")
    try:
        client = dask.Client(address, timeout=ANSWER_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise LinkError(
            f"no Dask scheduler answers at {address!r} within {ANSWER_S:g} s ({error}); start one"
            " with `dask scheduler`"
        ) from error
    if not client.scheduler_info()["workers"]:
        client.close()
        raise LinkError(
            f"the Dask scheduler at {address!r} has no workers; start some with `dask worker"
            f" {address}`"
        )
    threading.Thread(target=_look_on, args=(client, address), daemon=True).start()
    return client


def _look_on(client: Any, address: str) -> None:
    had = True
    while client.status == "running":
        has = bool(client.scheduler_info()["workers"])
        if had and not has:
            log.warning(
                "the Dask scheduler at %r has lost its last worker: nothing is computed until"
                " another one comes, `dask worker %s`; Ctrl-C ends",
                address,
                address,
            )
        had = has
        time.sleep(LOOK_S)
