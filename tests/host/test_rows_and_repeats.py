"""Damaged rows are never used, and a request that arrives twice is carried out once."""

from __future__ import annotations

import os
import re
import signal
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from waiting import freeze, until

from zendsp.errors import AcquisitionError, Refused, VariableError
from zendsp.link import Target
from zendsp.link.transfer import Rows
from zendsp_protocol import codec, keys
from zendsp_protocol import messages as m
from zendsp_protocol.chunks import crc, folded_crc
from zendsp_protocol.once import AGAIN, FIRST, stamp
from zendsp_protocol.version import PROTOCOL
from zendsp_target.runtime import Runtime


def chunk(rows: np.ndarray, first: int = 0) -> tuple[bytes, bytes]:
    """Header and payload of one chunk, as the target sends them."""
    payload = rows.astype("<f8").tobytes()
    header = m.ChunkHeader(
        v=PROTOCOL, first=first, rows=len(rows), columns=rows.shape[1], crc=folded_crc(payload)
    )
    return codec.encode(header), payload


@pytest.mark.parametrize("place", [0, 8 * 999, -1])
def test_a_chunk_with_a_flipped_bit_is_refused_and_what_came_before_is_kept(place: int) -> None:
    values = np.random.default_rng(1).normal(size=(1000, 3))
    rows = Rows(3, 2000)
    rows.take(*chunk(values))
    header, payload = chunk(values, 1000)
    hurt = bytearray(payload)
    hurt[place] ^= 0x10
    with pytest.raises(AcquisitionError, match=r"rows 1000…2000 arrived damaged"):
        rows.take(header, bytes(hurt))
    assert rows.pieces == [(0, 1000)] and np.array_equal(rows.data[:1000], values)


def test_a_chunk_that_was_cut_short_is_refused() -> None:
    _, payload = chunk(np.ones((10, 1)))
    short = codec.encode(
        m.ChunkHeader(v=PROTOCOL, first=0, rows=10, columns=1, crc=folded_crc(payload[:40]))
    )
    with pytest.raises(AcquisitionError, match="damaged"):
        Rows(1, 10).take(short, payload[:40])


def test_rows_that_are_damaged_on_the_way_are_never_a_recording(
    running: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = Rows.take

    def hurt(self: Rows, attachment: bytes, payload: bytes) -> None:
        take(self, attachment, payload[:-1] + bytes([payload[-1] ^ 1]))

    monkeypatch.setattr(Rows, "take", hurt)
    running.link.own = False  # elsewhere: rows come over the link
    with pytest.raises(AcquisitionError, match="damaged"):
        running.acquire(["q"], seconds=0.05)


def test_a_table_that_is_not_what_was_announced_is_refused(running: Target) -> None:
    data = np.arange(4.0).astype("<f8").tobytes()
    begun = running.request("table_begin", name="ref", dtype="<f8", length=4, crc=crc(data) ^ 1)
    running.request("table_chunk", upload=begun.upload, offset=0, data=data, crc=crc(data))
    with pytest.raises(Refused, match="CRC-32 of the whole differs"):
        running.request("table_commit", upload=begun.upload)


def test_a_request_that_arrives_twice_is_carried_out_once(running: Target) -> None:
    link = running.link

    def send(number: int, attempt: int) -> bytes:
        data = codec.encode_request("update", {"values": {"Kp1": 7.0}}, link.author)
        attachment = stamp(b"a-link-7", number, bytes.fromhex(running.info.instance), attempt)
        (reply,) = link.session.get(
            keys.rpc("fake", "sync"), payload=data, attachment=attachment, timeout=5.0
        )
        assert reply.ok is not None
        return reply.ok.payload.to_bytes()

    before = len(running.log())
    first = send(1, FIRST)
    assert [send(1, AGAIN), send(1, FIRST)] == [first, first]
    assert len(running.log()) == before + 1
    send(2, FIRST)
    assert len(running.log()) == before + 2


def test_a_recording_says_how_many_samples_were_late_in_it_and_by_how_much(
    loaded: Target, runtime: Runtime, typed: Callable[..., tuple[object, str, str]], tmp_path: Path
) -> None:
    """A simulated machine waits for a loop that stood still: no row is lost, and none in time."""
    words = ("acquire", "q", "-s", "1.5", "-o", tmp_path / "run.npz", "-t", "fake")

    def stall() -> None:
        until(lambda: loaded.acquire_status().count > 100, "rows")
        freeze(runtime.runner_pid())
        time.sleep(0.4)
        os.kill(runtime.runner_pid(), signal.SIGCONT)

    thread = threading.Thread(target=stall)
    thread.start()
    status, said, _ = typed(*words, "--start")
    thread.join()
    found = re.search(r" 0 lost, (\d+) samples? late, by up to (\d+) ms$", said.strip())
    assert status == 0 and found, said
    assert int(found[1]) >= 200 and int(found[2]) >= 390, said  # 400 samples, some caught up with


def test_what_is_uploaded_to_no_table_is_told_where_it_belongs(running: Target) -> None:
    with pytest.raises(VariableError, match=r'Kp1: is one number, no table: target\["Kp1"\] = '):
        running.upload("Kp1", [1.0, 2.0])
    with pytest.raises(VariableError, match=r"reff: no such variable.*did you mean ref"):
        running.upload("reff", np.zeros((3, 2)))
