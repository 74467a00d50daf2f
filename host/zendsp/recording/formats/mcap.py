"""MCAP: recordings of zendsp, and those of ROS 2 or JSON by other programs.

A recording is one topic whose messages are its rows, encoded as ROS 2 does: as doubles, so that
nothing is rounded. The unit of each field is beside it. Foxglove and PlotJuggler draw it. All other
parts of a recording are in the file's metadata.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zendsp.errors import RecordingError
from zendsp.extras import need
from zendsp.recording.formats.raw import Raw
from zendsp.recording.formats.ros import Topics

if TYPE_CHECKING:
    from zendsp.recording.recording import Recording

KEY = "zendsp"
TOPIC = "/recording"
SCHEMA = "zendsp_msgs/msg/Row"
HEAD = b"\x00\x01\x00\x00"  # CDR, little endian


def write(recording: Recording, metadata: str, path: Path) -> None:
    """Write ``recording``."""
    writers = need("mcap.writer", "files", "an MCAP file", RecordingError)
    fields = _fields(["t", *(c.name for c in recording.channels)])
    widths = [1, *(c.width for c in recording.channels)]
    units = ["s", *(c.unit for c in recording.channels)]
    lines = [
        f"float64{f'[{width}]' if width > 1 else ''} {name}{f'  # {unit}' if unit else ''}"
        for name, width, unit in zip(fields, widths, units, strict=True)
    ]
    rows = np.ascontiguousarray(np.column_stack([recording.t, recording.data]), dtype="<f8")
    start_ns = round(recording.created * 1e9)
    with path.open("wb") as file:
        writer = writers.Writer(file)
        writer.start(profile="ros2", library="zendsp")
        schema = writer.register_schema(SCHEMA, "ros2msg", "\n".join(lines).encode())
        channel = writer.register_channel(
            TOPIC,
            "cdr",
            schema,
            {name: unit for name, unit in zip(fields, units, strict=True) if unit},
        )
        for k, t in enumerate(recording.t):
            stamp = start_ns + round(float(t) * 1e9)
            writer.add_message(
                channel, max(stamp, 0), HEAD + rows[k].tobytes(), max(stamp, 0), k & 0xFFFFFFFF
            )
        writer.add_metadata(KEY, {"circumstances": metadata, "fields": json.dumps(fields)})
        writer.finish()


def _fields(names: list[str]) -> list[str]:
    """Different names that ROS 2 allows: lower case, beginning with a letter, single underscores.
    """
    fields: list[str] = []
    for name in names:
        plain = re.sub(r"_+", "_", re.sub(r"[^a-z0-9]", "_", name.lower())).strip("_")
        plain = plain if plain[:1].isalpha() else f"c_{plain}".strip("_")
        own, number = plain, 2
        while own in fields:
            own, number = f"{plain}_{number}", number + 1
        fields.append(own)
    return fields


def read(path: Path) -> Raw:
    """Read any MCAP whose messages are of ROS 2 or JSON."""
    readers = need("mcap.reader", "files", "an MCAP file", RecordingError)
    with path.open("rb") as file:
        reader = readers.make_reader(file, validate_crcs=True)
        own = {m.name: m.metadata for m in reader.iter_metadata()}.get(KEY)
        if own:
            return _own(reader, own)
        if KEY in reader.get_header().library:
            raise RecordingError(
                f"{path}: is damaged: it was written by zendsp, and its description is gone. Take"
                " another copy"
            )
        return _foreign(path, reader)


def _own(reader: Any, own: dict[str, str]) -> Raw:
    rows = [
        message.data[4:]
        for _, _, message in reader.iter_messages(topics=[TOPIC], log_time_order=False)
    ]
    channels = json.loads(own["circumstances"])["channels"]
    width = 1 + sum(channel["width"] for channel in channels)
    data = np.frombuffer(b"".join(rows), dtype="<f8").reshape(-1, width).astype(np.float64)
    columns, units, first = {"t": data[:, 0]}, {"t": "s"}, 1
    for channel in channels:
        last = first + channel["width"]
        columns[channel["name"]] = data[:, first] if channel["width"] == 1 else data[:, first:last]
        units[channel["name"]], first = channel["unit"], last
    return Raw(columns, units, {}, own["circumstances"])


def _foreign(path: Path, reader: Any) -> Raw:
    topics = Topics()
    decoders: dict[int, Any] = {}
    for schema, channel, message in reader.iter_messages(log_time_order=False):
        if channel.topic in topics.refused:
            continue
        if channel.id not in decoders:
            decoders[channel.id] = _decoder(channel, schema)
        decode = decoders[channel.id]
        if isinstance(decode, str):
            topics.refused[channel.topic] = decode
        else:
            topics.add(channel.topic, message.log_time, decode(message.data))
    return topics.raw(path)


def _decoder(channel: Any, schema: Any) -> Any:
    """A function from bytes to a message, or why there is none."""
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding == "cdr" and schema is not None and schema.encoding == "ros2msg":
        need("rosbags", "files", "an MCAP file of ROS 2", RecordingError)
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(schema.data.decode(), schema.name))
        return lambda data: store.deserialize_cdr(data, schema.name)
    encoding = (
        f"{channel.message_encoding} with {schema.encoding}" if schema else channel.message_encoding
    )
    return f"is in {encoding or 'an unknown encoding'}; ROS 2 (cdr with ros2msg) and JSON are read"
