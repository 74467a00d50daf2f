"""Refuses unknown keys in files that users write."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

from zendsp_protocol.errors import did_you_mean


def unknown_keys(data: Mapping[str, Any], allowed: Collection[str], where: str) -> str:
    """A line for each key of a table that is not read, with the most similar one that is; ``""``
    where there is none.

    Parameters
    ----------
    data : mapping
        The table.
    allowed : collection of str
        Keys that are read.
    where : str
        File and table, for example ``"bench.toml: [actuator]"``.

    Examples
    --------
    >>> unknown_keys({"dealy": 0.004}, ("gain", "delay"), "bench.toml: [actuator]")
    "bench.toml: [actuator] has no key 'dealy'; did you mean delay? Allowed: gain, delay"
    """
    lines = []
    for key in data:
        if key not in allowed:
            lines.append(f"{where} has no key {key!r}; {did_you_mean(key, allowed)}")
    return "\n".join(lines)
