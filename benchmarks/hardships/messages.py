"""Messages that nobody should send: noise, damaged requests, wrong values, wrong lanes."""

from __future__ import annotations

import random
from collections.abc import Iterator
from typing import Any

import msgspec
import zenoh

import zendsp
from hardships.place import Growth, Place, Tally
from zendsp_protocol import codec, keys
from zendsp_protocol.verbs import VERBS, Verb

PROMISE = "whatever is sent gets one reply that names an error or a result, and the target goes on"
MESSAGES = 300  # of a round
MOST_MB = 64.0  # that a target may grow; it remembers the last replies of 256 connections
# those of programs that were replaced are closed when Python next looks for cycles
MOST_FILES = 250
FINAL = 5.0  # s, in which a reply has to be there
WEIRD: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    3,
    2**31,
    2**63 - 1,
    -(2**63),
    2**64 - 1,
    0.0,
    -1e-300,
    1e300,
    float("inf"),
    float("nan"),
    "",
    "q",
    "Kp1",
    "stop",
    "torque",
    "x" * 5000,
    "ä\x00\n",
    b"",
    b"\xff" * 9,
    [],
    ["q"],
    ["q", 1],
    [[]],
    [0.0] * 100,
    {},
    {"Kp1": 4.0},
    {"Kp1": "x"},
    {"": None},
    {"dtype": "<f8", "data": b"abc", "columns": 1},
    {"dtype": "<f8", "data": b"\x00" * 16, "columns": -1},
    {"dtype": "O", "data": b"", "columns": 0},
    {1: 2},
)
WAITS = ("at_tick", "timeout")  # of these a large one is a long wait that was asked for
SHORT: tuple[Any, ...] = (None, -1, 0, "x", float("nan"), [])
REFUSES_SERVICE = ("unload", "reveal")  # asked for rightly, they leave nothing to fuzz


def rounds(place: Place, tally: Tally) -> Iterator[None]:
    """See the module."""
    draw = random.Random(7)
    with place.local("fuzzed") as target:
        target.download("pd.c")
        growth = Growth(target.info.pid)
        while True:
            # a message may have taken the right, switched the power off, or pressed STOP
            target.take_command(force=True)
            target.set_inputs(0)
            if target.drive_status().explicit:
                target.pause()  # disabled while it runs, it would move at once
                target.drive_auto()
            target.release_command()
            if target.status().state != "running":
                target.acknowledge()
                target.download("pd.c")
                target.start()
            with zendsp.connect("fuzzed") as other:
                for _ in range(MESSAGES):
                    _send(other.link.session, *_message(draw), tally)
            tick = target.status().tick
            status = target.status()
            tally.expect(status.crash == "", f"the runner crashed: {status.crash}")
            tally.expect(isinstance(target["Kp1"], float), "Kp1 is not read any more")
            if status.state == "running":
                target.run_for(0.0) if status.clock == "fast" else None
                tally.expect(target.status().tick >= tick, "the samples stand still")
            megabytes, files, threads = growth.look()
            tally.measure("growth of the target, MB", megabytes)
            tally.measure("growth of the target, open files", files)
            tally.measure("growth of the target, threads", threads)
            tally.expect(megabytes < MOST_MB, f"the target grew by {megabytes:.0f} MB")
            tally.expect(files < MOST_FILES, f"the target has {files} files more open")
            yield


def _message(draw: random.Random) -> tuple[str, bytes | None, bytes | None]:
    """Lane, payload and attachment of one message."""
    verb = draw.choice([v for v in VERBS.values() if v.name not in REFUSES_SERVICE])
    lane, how = verb.lane, draw.random()
    payload: bytes | None
    if how < 0.15:
        payload = draw.choice([None, draw.randbytes(draw.randrange(2000))])
    elif how < 0.45:
        payload = _damaged(
            draw, codec.encode_request(verb.name, _arguments(draw, verb, 0.0), "fuzz")
        )
    else:
        payload = _odd(draw, verb)
    if draw.random() < 0.1:
        lane = draw.choice(keys.LANES)
    attachment = draw.choice([None, None, draw.randbytes(25), draw.randbytes(draw.randrange(60))])
    return lane, payload, attachment


def _damaged(draw: random.Random, good: bytes) -> bytes:
    data = bytearray(good)
    match draw.randrange(3):
        case 0:
            return bytes(data[: draw.randrange(len(data))])
        case 1:
            return bytes(data + draw.randbytes(draw.randrange(1, 40)))
        case _:
            for _ in range(draw.randrange(1, 5)):
                data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)
            return bytes(data)


def _odd(draw: random.Random, verb: Verb) -> bytes:
    envelope: dict[Any, Any] = {
        "v": 1,
        "verb": verb.name,
        "by": "fuzz",
        "args": _arguments(draw, verb, 0.5),
    }
    if draw.random() < 0.2:
        envelope[draw.choice(["v", "verb", "by", "args"])] = draw.choice(WEIRD)
    if draw.random() < 0.05:
        envelope.pop(draw.choice(list(envelope)))
    if draw.random() < 0.02:
        return b"\x91" * draw.choice([100, 10_000]) + b"\xc0"  # lists in lists
    return codec.encode(envelope)


def _arguments(draw: random.Random, verb: Verb, weird: float) -> dict[Any, Any]:
    made: dict[Any, Any] = {}
    for field in msgspec.structs.fields(verb.arguments):
        chance = draw.random()
        if not field.required and chance < 0.3:
            continue
        pool = SHORT if field.name in WAITS else WEIRD
        odd = draw.random() < weird or field.name in WAITS
        made[field.name] = draw.choice(pool) if odd else _fitting(draw, field.name)
    if draw.random() < 0.1 * weird:
        made[draw.choice(["typo", "", "values"])] = draw.choice(WEIRD)
    return made


def _fitting(draw: random.Random, name: str) -> Any:
    """Something of the right type, and often of the right value."""
    fits: dict[str, tuple[Any, ...]] = {
        "sources": (
            {"a.c": '#include "isr.h"\nvoid UserInit(void) {}\nvoid UserISR_INT2(void) {}\n'},
            {"../a.c": ""},
            {"a.c": "("},
        ),
        "flags": ([], ["-O3"], ["-fplugin=x"], ["@file"]),
        "key": ("0" * 64, "../../x", ""),
        "names": (["q"], ["Kp1", "q[0]"], ["q[9]"], []),
        "channels": (["q"], ["tau", "q[1]"], ["none"], []),
        "values": ({"Kp1": 100.0}, {"Kp1": -1.0}, {"none": 1}, {"q": 1.0}, {}),
        "name": ("ref", "Kp1", "none"),
        "dtype": ("<f8", "|O"),
        "length": (8, 0, 2**40),
        "crc": (0, 2**32 - 1),
        "upload": (0, 1, 99),
        "offset": (0, 8, 2**40),
        "data": (b"", b"\x00" * 64),
        "first": (0, 10, 2**62),
        "count": (0, 5, 2**62),
        "chunk": (1, 1 << 20, 0),
        "mode": ("torque", "velocity", "off"),
        "policy": ("stop", "hold", "count", "trip"),
        "action": (
            "take", "release", "power_on", "power_off", "home", "enable", "disable", "acknowledge",
            "auto", "host_lost",
        ),
    }
    return draw.choice(fits.get(name, (0, 1, 0.01, True)))


def _send(
    session: zenoh.Session, lane: str, payload: bytes | None, attachment: bytes | None, tally: Tally
) -> None:
    said = f"{lane} {payload[:200] if payload else payload!r} {attachment!r}"
    replies = list(
        session.get(
            keys.rpc("fuzzed", lane), zenoh.handlers.FifoChannel(4096), payload=payload,
            attachment=attachment, consolidation=zenoh.ConsolidationMode.NONE, timeout=FINAL,
        )
    )
    tally.count("messages")
    last = [r.ok for r in replies if r.ok is not None and r.ok.attachment is None]
    if not tally.expect(
        len(last) == 1 and not any(r.err for r in replies), f"{len(last)} replies: {said}"
    ):
        return
    try:
        reply = msgspec.msgpack.decode(last[0].payload.to_bytes(), type=codec.Reply)
    except msgspec.MsgspecError as error:
        tally.expect(False, f"no reply of the protocol ({error}): {said}")
        return
    kind = reply.error.kind if reply.error is not None else "ok"
    tally.count(f"answered {'with a result' if reply.ok else 'with an error'}")
    tally.expect(reply.ok == (reply.error is None) and kind != "Internal", f"{reply.error}: {said}")
