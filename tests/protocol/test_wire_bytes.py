"""The bytes on the wire are those of version 1, recorded with another MessagePack library than the
one that makes them now.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgpack
import numpy as np
import pytest

from zendsp_protocol import codec, values, verbs
from zendsp_protocol import messages as m
from zendsp_protocol.errors import VariableError

RECORDED: dict[str, str] = json.loads(
    (Path(__file__).parent / "wire_bytes.json").read_text(encoding="utf-8")
)
TRIGGER = m.Trigger(source="q[0]", level=-0.5, edge="rising", pre_s=0.25)
NUMBERS = [
    0,
    127,
    128,
    255,
    256,
    65535,
    65536,
    2**32 - 1,
    2**32,
    2**64 - 1,
    -1,
    -32,
    -33,
    -128,
    -129,
    -32769,
    -(2**31) - 1,
    -(2**63),
]
MESSAGES: dict[str, Callable[[], bytes]] = {
    "write": lambda: codec.encode_request(
        "write", {"values": {"Kp1": 450.0, "on": True, "n": -3}}, "anna@lab:1"
    ),
    "update at": lambda: codec.encode_request(
        "update", verbs.Write(values={"g": [1.0, 2.5]}, at_tick=70_000), "é"
    ),
    "packed": lambda: codec.encode_request(
        "update", {"values": {"g": values.to_wire(np.arange(65.0))}}, "a"
    ),
    "table": lambda: codec.encode_request(
        "table_chunk", verbs.TableChunk(upload=1, offset=300, data=bytes(300), crc=2**32 - 1), "a"
    ),
    "trigger": lambda: codec.encode_request(
        "acquire_configure", {"channels": ["q"], "trigger": TRIGGER, "seconds": 1.0}, "a"
    ),
    "read": lambda: codec.encode_request("read", {"names": ("Kp1", "q[1]")}, "a" * 40),
    "applied": lambda: codec.encode_result(m.Applied(sequence=1, tick=5012)),
    "reading": lambda: codec.encode_result(
        {
            "tick": 2**40,
            "values": {
                "q": np.array([0.1, -0.0]),
                "n": np.int32(7),
                "f": np.float32(0.5),
                "on": np.bool_(True),
                "x": np.float64(1e-300),
            },
        }
    ),
    "tables": lambda: codec.encode_result(
        {
            "tick": 1,
            "values": {"ref": np.arange(6.0).reshape(3, 2), "long": np.arange(70, dtype=np.int32)},
        }
    ),
    "numbers": lambda: codec.encode(NUMBERS),
    "odd floats": lambda: codec.encode([float("inf"), float("-inf"), 1.0, 5e-324]),
    "nothing": lambda: codec.encode_result(m.Empty()),
    "none": lambda: codec.encode_result(None),
    "dataclasses": lambda: codec.encode_result(
        (m.Change(3, 1.5, "Kp1", 1.0, np.array([2.0, 3.0]), "me"), m.Trigger("q", 0.0, "both", 0.0))
    ),
    "texts": lambda: codec.encode(
        {"a" * 31: "b" * 32, "c": "d" * 256, "e": None, "f": [], "g": {}, "h": list(range(16))}
    ),
    "error": lambda: codec.encode_error(VariableError("Kp1: 2e+04 …"), {"name": "Kp1"}),
    "bug": lambda: codec.encode_error(ZeroDivisionError("x")),
    "live": lambda: codec.encode(
        m.LiveHeader(v=1, session=2, first=3, rows=4, columns=("q",), tick=5, decimation=1, lost=0)
    ),
    "bytes": lambda: codec.encode(
        {"a": b"\x00\xff", "b": bytearray(3), "c": memoryview(b"xyz"), "d": b"y" * 70_000}
    )[:300],
}


@pytest.mark.parametrize("name", MESSAGES)
def test_the_bytes_are_those_that_were_recorded(name: str) -> None:
    assert MESSAGES[name]().hex() == RECORDED[name]


def test_any_messagepack_library_reads_them() -> None:
    def read(name: str) -> Any:
        return msgpack.unpackb(bytes.fromhex(RECORDED[name]))

    assert read("write") == {
        "v": 1,
        "verb": "write",
        "by": "anna@lab:1",
        "args": {"values": {"Kp1": 450.0, "on": True, "n": -3}},
    }
    assert read("applied") == {"v": 1, "ok": True, "result": {"sequence": 1, "tick": 5012}}
    assert read("numbers") == NUMBERS and read("none") == {"v": 1, "ok": True}


def record() -> None:
    """Write the recorded bytes anew: only together with another version of the protocol."""
    path = Path(__file__).parent / "wire_bytes.json"
    path.write_text(
        json.dumps({name: make().hex() for name, make in MESSAGES.items()}, indent=1) + "\n",
        encoding="utf-8",
    )
