"""The Dask cluster that a scheduler's address names."""

from __future__ import annotations

from typing import Any

from zendsp.errors import LinkError
from zendsp.extras import need


def connect(address: str) -> Any:
    """A client of the Dask scheduler at `address`, which has workers.

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
        client = dask.Client(address, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise LinkError(
            f"no Dask scheduler answers at {address!r} within 10 s ({error}); start one with `dask"
            " scheduler`"
        ) from error
    if not client.scheduler_info()["workers"]:
        client.close()
        raise LinkError(
            f"the Dask scheduler at {address!r} has no workers; start some with `dask worker"
            f" {address}`"
        )
    return client
