"""ROS bags: messages of any type become columns; the elements of JointState and similar messages
are named after their joints.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from zendsp.errors import RecordingError
from zendsp.extras import need
from zendsp.recording.formats.clocks import Series, on_one_clock
from zendsp.recording.formats.raw import Raw
from zendsp.recording.names import FloatArray

NAMES = ("name", "joint_names")  # of the fields that name what the arrays beside them are of
MOST = 200  # numbers in a message; images and point clouds are no signals


class Topics:
    """Collects messages into one series for each topic and layout.

    Two publishers on one topic whose messages name different joints make two series.
    """

    def __init__(self) -> None:
        self._rows: dict[tuple[str, tuple[str, ...]], tuple[list[int], list[list[float]]]] = {}
        self.refused: dict[str, str] = {}

    def add(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Take one message, received at ``stamp_ns``; the time in its own header is used where it
        has one.
        """
        if topic in self.refused:
            return
        found: dict[str, float] = {}
        _flatten(message, "", found)
        own = _header(message)
        if len(found) > MOST:
            self.refused[topic] = (
                f"has {len(found)} numbers in a message; signals have {MOST} at most"
            )
        elif found:
            times, rows = self._rows.setdefault((topic, tuple(found)), ([], []))
            times.append(own if own is not None else stamp_ns)
            rows.append(list(found.values()))

    def raw(self, path: Path) -> Raw:
        """All series on one clock."""
        series: list[Series] = []
        seen: list[str] = []
        start = min((times[0] for times, _ in self._rows.values()), default=0)
        for (topic, names), (times, rows) in self._rows.items():
            data = np.array(rows)
            number = seen.count(topic)
            seen.append(topic)
            columns: dict[str, FloatArray] = {
                n: np.ascontiguousarray(data[:, k]) for k, n in enumerate(names)
            }
            t: FloatArray = (np.array(times, dtype=np.int64) - start).astype(np.float64) * 1e-9
            series.append(Series(topic if not number else f"{topic}_{number + 1}", t, columns))
        return on_one_clock(path, series, self.refused, prefix=True)


def read(path: Path) -> Raw:
    """Read a bag: a folder of rosbag2, a single ``.db3``, or a ``.bag`` of ROS 1."""
    need("rosbags", "files", "a ROS bag", RecordingError)
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    topics = Topics()
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        known = reader.typestore.fielddefs
        for connection in reader.connections:
            if connection.msgtype not in known:
                topics.refused[connection.topic] = (
                    f"is a {connection.msgtype}, which the bag does not define"
                )
        wanted = [c for c in reader.connections if c.msgtype in known]
        for connection, stamp, data in reader.messages(connections=wanted):
            if connection.topic not in topics.refused:
                topics.add(connection.topic, stamp, reader.deserialize(data, connection.msgtype))
    return topics.raw(path)


def _header(message: Any) -> int | None:
    """The time in the message's own header, ns; None where it has none, or 0."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None:
        return None
    seconds, rest = getattr(stamp, "sec", 0), getattr(stamp, "nanosec", getattr(stamp, "nsec", 0))
    return int(seconds) * 1_000_000_000 + int(rest) or None


def _flatten(message: Any, where: str, found: dict[str, float]) -> None:
    """The numbers of a message by dotted names; elements of arrays beside a list of names get those
    names.
    """
    fields = _fields(message)
    names = next((list(value) for key, value in fields if key in NAMES and _strings(value)), [])
    for key, value in fields:
        if key in ("header", "stamp") or key.startswith("__"):
            continue
        place = f"{where}{key}"
        if isinstance(value, bool | int | float | np.number):
            found[place] = float(value)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiub":
            _array(value.reshape(-1), where, key, names, found)
        elif (
            isinstance(value, list | tuple)
            and value
            and all(isinstance(v, int | float) for v in value)
        ):
            _array(value, where, key, names, found)
        elif isinstance(value, list | tuple) and len(value) == 1 and _fields(value[0]):
            _named(value[0], f"{place}.", names, found)  # a trajectory of one point is a command
        elif not isinstance(value, list | tuple | str | bytes | np.ndarray) and value is not None:
            _named(value, f"{place}.", names, found)


def _named(message: Any, where: str, names: list[str], found: dict[str, float]) -> None:
    for key, value in _fields(message):
        if names and isinstance(value, np.ndarray) and len(value) == len(names):
            _array(value, where, key, names, found)
        elif not names or not isinstance(value, np.ndarray):
            _flatten({key: value}, where, found)


def _array(
    values: Iterable[Any], where: str, key: str, names: list[str], found: dict[str, float]
) -> None:
    items = list(values)
    for k, value in enumerate(items):
        own = len(items) == len(names)
        place = (
            f"{where}{names[k]}.{key}"
            if own
            else f"{where}{key}[{k}]" if len(items) > 1 else f"{where}{key}"
        )
        found[place] = float(value)


def _fields(message: Any) -> list[tuple[str, Any]]:
    if isinstance(message, dict):
        return list(message.items())
    return list(vars(message).items()) if hasattr(message, "__dict__") else []


def _strings(value: Any) -> bool:
    return (
        isinstance(value, list | tuple) and bool(value) and all(isinstance(v, str) for v in value)
    )
