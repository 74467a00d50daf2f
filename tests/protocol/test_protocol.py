"""The wire contract: malformed messages are refused in words, and the documentation matches the
code.
"""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import re
import subprocess
import sys
from pathlib import Path

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zendsp_protocol import chunks, codec, errors, keys, registry, values, version
from zendsp_protocol import messages as m
from zendsp_protocol.errors import LinkError, Refused, VariableError, VersionMismatch, ZendspError
from zendsp_protocol.pieces import check_pieces
from zendsp_protocol.states import DriveState, ProgramState, TripReason
from zendsp_protocol.values import Packed, from_wire
from zendsp_protocol.verbs import ROLES, VERBS

DOCS = Path(__file__).parents[2] / "docs"


def test_a_request_survives_the_wire() -> None:
    data = codec.encode_request(
        "update",
        {"values": {"Kp": 1.5, "on": True, "n": 3, "g": [1.0, 2.0]}, "at_tick": 7},
        "anna@lab",
    )
    verb, args, by = codec.decode_request(data, "sync")
    assert (verb.name, by, args.at_tick) == ("update", "anna@lab", 7)  # type: ignore[attr-defined]
    assert args.values == {"Kp": 1.5, "on": True, "n": 3, "g": [1.0, 2.0]}  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    "value",
    [
        1.5,
        3,
        True,
        [1.0, 2.0],
        np.arange(3.0),
        np.arange(500.0),
        np.arange(500, dtype=np.int32),
        np.ones(99, np.bool_),
        np.arange(200.0).reshape(100, 2),
        np.float32(2.5),
        np.int64(4),
        np.arange(99, dtype=np.float32),
    ],
)
def test_values_survive_the_wire(value: object) -> None:
    data = codec.encode(m.Reading(tick=1, values={"x": values.to_wire(value)}))
    back = values.from_wire(codec.decode(data, m.Reading).values["x"])
    assert np.array_equal(np.asarray(back), np.asarray(value)) and np.shape(back) == np.shape(value)


@pytest.mark.parametrize(
    "value",
    [
        "text", None, 1 + 2j, np.zeros((2, 2, 2)), {"a": 1}, 2**63, -(10**400), 10**4000,
        [[1, 2, 3], [4, 5]], [[1], 2],
    ],
)  # fmt: skip
def test_what_is_not_a_number_is_refused_as_a_value(value: object) -> None:
    with pytest.raises(TypeError):
        values.to_wire(value)


def test_a_result_and_an_error_survive_the_wire() -> None:
    assert (
        codec.decode_reply(codec.encode_result(m.Applied(sequence=1, tick=2)), m.Applied).tick == 2
    )
    with pytest.raises(VariableError, match="Kp: too large"):
        codec.decode_reply(codec.encode_error(VariableError("Kp: too large")), m.Applied)
    with pytest.raises(errors.Refused, match="this is a bug"):
        codec.decode_reply(codec.encode_error(ZeroDivisionError("x")), m.Applied)


@settings(max_examples=300, deadline=None)
@given(
    st.one_of(
        st.binary(max_size=300),
        st.recursive(
            st.none()
            | st.booleans()
            | st.integers(-(2**63), 2**64 - 1)
            | st.floats()
            | st.text(max_size=9)
            | st.binary(max_size=9),
            lambda inner: (
                st.lists(inner, max_size=4)
                | st.dictionaries(
                    st.sampled_from(["v", "verb", "by", "args", "ok", "x"]), inner, max_size=5
                )
            ),
            max_leaves=12,
        ).map(msgspec.msgpack.encode),
    )
)
def test_no_bytes_whatever_get_past_the_decoder_or_break_it(data: bytes) -> None:
    for lane in keys.LANES:
        with pytest.raises(LinkError):
            codec.decode_request(data, lane)
    with contextlib.suppress(ZendspError):
        codec.decode_reply(data, m.Status)


def test_versions_that_differ_say_which_side_to_upgrade() -> None:
    older = codec.encode_request("status", {}, "me", version=version.PROTOCOL - 1)
    with pytest.raises(VersionMismatch, match="upgrade zendsp on the host"):
        codec.decode_request(older, "quick")
    newer = codec.encode({"v": version.PROTOCOL + 1, "ok": True, "result": {"new": "form"}})
    with pytest.raises(
        VersionMismatch,
        match=(
            r"the target speaks protocol 2, the host speaks protocol 1: upgrade zendsp on the host"
        ),
    ):
        codec.decode_reply(newer, m.Status)
    # An old host reads the sentence of a new target, whatever else has changed.
    answer = {
        "v": 9,
        "ok": False,
        "error": {"kind": "VersionMismatch", "message": "upgrade", "severity": 3},
        "more": 1,
    }
    with pytest.raises(VersionMismatch, match="upgrade"):
        codec.decode_reply(codec.encode(answer), m.Status)


def test_a_trip_for_a_reason_of_a_newer_target_is_read_and_its_sentence_kept() -> None:
    told = codec.encode_result({"reason": "cosmic ray", "text": "a cosmic ray", "tick": 7})
    trip = codec.decode_reply(told, m.Trip)
    assert (trip.reason, trip.text, trip.tick) == (TripReason.OTHER, "a cosmic ray", 7)


def test_new_fields_of_a_newer_target_are_ignored() -> None:
    reply = codec.encode(
        {"v": 1, "ok": True, "result": {"sequence": 1, "tick": 5, "added_later": [1, 2]}}
    )
    assert codec.decode_reply(reply, m.Applied).tick == 5


def test_every_error_of_the_tree_crosses_the_wire_as_itself() -> None:
    kinds = [e for e in vars(errors).values() if isinstance(e, type) and issubclass(e, ZendspError)]
    assert len(kinds) > 10
    for kind in kinds:
        with pytest.raises(kind, match="why"):
            codec.decode_reply(codec.encode_error(kind("why")), m.Empty)
        assert f" {kind.__name__} " in f"{errors.__doc__}".replace("\n", " "), "the tree lacks it"


def test_texts_from_elsewhere_command_no_terminal() -> None:
    rude, exact = "anna@\x1b[2J\r\n\x9b2J\u202e", "int x;\r\n\x1b"
    written = "anna@\\x1b[2J\\r\n\\x9b2J\\u202e"
    said = codec.encode_result(
        m.Program(key="k", sources={"a.c": exact}, flags=[rude], compiler="gcc")
    )
    program = codec.decode_reply(said, m.Program)
    assert program.sources == {"a.c": exact} and list(program.flags) == [written]
    with pytest.raises(errors.Refused, match=r"^anna@\\x1b\[2J\\r\n\\x9b2J\\u202e$"):
        codec.decode_reply(codec.encode_error(errors.Refused(rude)), m.Empty)
    _, _, by = codec.decode_request(codec.encode_request("info", {}, rude), "quick")
    assert by == written.replace("\n", "\\n")  # a name has one line
    assert keys.host_of(f"zendsp/imi/host/{rude}") == by


def test_names_that_keys_cannot_hold_are_refused() -> None:
    assert keys.check_name("imi-1.b_2") == "imi-1.b_2"
    for name in ("", "a/b", "a*", "x" * 65, "a b", "ä", ".", "..", "..."):
        with pytest.raises(ValueError, match="target name"):
            keys.check_name(name)
    assert keys.target_of(keys.variable("imi", "Kp")) == "imi"


def test_chunks_cover_everything_once_and_gaps_find_what_is_missing() -> None:
    rng = np.random.default_rng(3)
    for _ in range(200):
        first, count, step = (int(n) for n in rng.integers(0, 50, 3))
        pieces = list(chunks.spans(first, count, step))
        assert list(itertools.chain(*(range(a, a + n) for a, n in pieces))) == list(
            range(first, first + count)
        )
        kept = [piece for piece in pieces if rng.random() < 0.5]
        missing = chunks.gaps(kept, first, count)
        covered = sorted(itertools.chain(*(range(a, a + n) for a, n in kept + missing)))
        assert covered == list(range(first, first + count))


def test_the_folded_checksum_is_as_documented_and_sees_every_damaged_byte() -> None:
    import zlib

    rng = np.random.default_rng(4)
    for size in (0, 1, 4095, 4096, 4097, 100_000):
        data = rng.bytes(size)
        folded = bytearray(4096)
        for k, byte in enumerate(data):
            folded[k % 4096] ^= byte
        assert chunks.folded_crc(data) == zlib.crc32(folded)
        if size:
            for place in rng.integers(0, size, 20):
                damaged = bytearray(data)
                damaged[place] ^= 1 << int(rng.integers(0, 8))
                assert chunks.folded_crc(bytes(damaged)) != chunks.folded_crc(data)


def test_an_entry_of_the_registry_counts_only_while_its_process_lives() -> None:
    import os
    import subprocess

    assert registry.born(os.getpid())
    with subprocess.Popen(["true"]) as process:
        process.wait()
    assert registry.born(process.pid) == "" or registry.born(process.pid) != registry.born(
        os.getpid()
    )
    assert registry.folder({"XDG_RUNTIME_DIR": "/run/user/7"}) == "/run/user/7/zendsp"
    uid = os.getuid()
    session, none = f"/run/user/{uid}/zendsp", f"/tmp/zendsp-{uid}"
    assert registry.folders({"XDG_RUNTIME_DIR": f"/run/user/{uid}"}) == [session, none]
    assert registry.folders({}) == [none, session]
    assert registry.folders({"ZENDSP_RUNTIME_DIR": "/x", "XDG_RUNTIME_DIR": "/y"}) == ["/x"]
    assert registry.folder({"ZENDSP_RUNTIME_DIR": "/x", "XDG_RUNTIME_DIR": "/run/user/7"}) == "/x"


def test_the_documentation_lists_every_verb_and_field_as_they_are() -> None:
    spec = importlib.util.spec_from_file_location(
        "generate_protocol", DOCS / "generate_protocol.py"
    )
    assert spec is not None and spec.loader is not None
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    text = (DOCS / "protocol.md").read_text(encoding="utf-8")
    assert generate.updated(text) == text, (
        "docs/protocol.md is behind the code: run python docs/generate_protocol.py"
    )
    for key in (
        keys.rpc("<target>", "<lane>"),
        keys.info("<target>"),
        keys.variable("<target>", "<name>"),
        keys.event("<target>"),
        keys.live("<target>", "<n>"),
        keys.alive("<target>"),
        keys.host("<target>", "<host>"),
    ):
        assert f"`{key}`" in text, key


def test_what_a_target_returns_is_read_in_a_line_at_the_prompt() -> None:
    counts = values.to_wire(np.arange(160))
    timing = m.Timing(
        ticks=11553,
        overruns=43,
        exec_mean_ns=1251.2,
        exec_max_ns=140668,
        late_mean_ns=11814.1,
        late_max_ns=6568787,
        exec_histogram=counts,
        late_histogram=counts,
        histogram_edges_ns=counts,
    )
    trip = m.Trip(reason="stop", tick=11551, text="STOP was requested (sample 11551)")
    status = m.Status(
        state=ProgramState.STOPPED,
        tick=11553,
        t=11.553,
        rate_hz=1000.0,
        machine="imi_planar",
        timing=timing,
        drive=DriveState.STOPPED,
        trip=trip,
    )
    assert repr(counts) == "<Packed 160 x <i8>"
    assert repr(timing) == (
        "<Timing 11553 samples, 43 overruns, 0 missed; execution 1.3 (at most 140.7) us, "
        "late 11.8 (at most 6568.8) us>"
    )
    assert repr(status) == (
        "<Status imi_planar: stopped, drives stopped, 11.553 s at 1000 Hz, "
        "STOP was requested (sample 11551)>"
    )
    result = m.CompileResult(ok=True, key="5b", seconds=0.0038, cached=True, compiler="cc")
    assert repr(result) == "<CompileResult ok in 0.0038 s (from the cache)>"
    wrong = m.Diagnostic(severity="error", file="pd.c", line=3, column=5, message="expected ';'")
    result = m.CompileResult(ok=False, key="", seconds=0.1, diagnostics=(wrong,))
    assert repr(result) == "<CompileResult not compiled; pd.c:3:5: error: expected ';'>"


def test_the_page_on_security_lists_every_verb_under_its_role() -> None:
    page = (DOCS / "security.md").read_text()
    said = {
        role: set(re.findall(r"`(\w+)`", names))
        for role, names in re.findall(r"^- `(\w+)`: ((?:`\w+`,?\s*)+)", page, re.MULTILINE)
    }
    assert said == {
        role: {verb.name for verb in VERBS.values() if verb.role == role} for role in ROLES
    }


@pytest.mark.parametrize("data", [b"\x91" * 4000, b"\xc1", b"", b"\x81\xa1a"])
def test_what_is_no_message_is_refused_in_words(data: bytes) -> None:
    decoders = (lambda d: codec.decode_request(d, "quick"), lambda d: codec.decode_reply(d, int))
    for decode in decoders:
        with pytest.raises(LinkError, match=r"malformed (request|reply): \w+"):
            decode(data)


@pytest.mark.parametrize(
    ("value", "pieces"),
    [
        (None, 1), (-33, 1), (2**40, 1), (0.5, 1), ("é" * 200, 1), (b"z" * 300, 1),
        (msgpack.ExtType(3, b"z" * 17), 1), ([1, [2.0, "x"]], 5), ({"a": {"b": [None] * 20}}, 25),
    ],
)  # fmt: skip
def test_the_pieces_of_a_message_are_counted(
    monkeypatch: pytest.MonkeyPatch, value: object, pieces: int
) -> None:
    monkeypatch.setattr("zendsp_protocol.pieces.SMALL", 0)
    monkeypatch.setattr("zendsp_protocol.pieces.MOST", pieces)
    check_pieces(msgpack.packb(value), texts=True)
    monkeypatch.setattr("zendsp_protocol.pieces.MOST", pieces - 1)
    with pytest.raises(LinkError, match="packed"):
        check_pieces(msgpack.packb(value), texts=True)


def test_a_request_that_would_take_long_to_decode_is_refused() -> None:
    """20 MB of empty maps had blocked every thread of a target for four seconds."""
    args = {"x": [{}] * 100_001}
    many = msgpack.packb({"v": version.PROTOCOL, "verb": "status", "by": "x", "args": args})
    with pytest.raises(LinkError, match="more than 100000"):
        codec.decode_request(many, "quick")
    long = codec.encode_request("read", {"names": ["x" * 70_000]}, "x")
    with pytest.raises(LinkError, match="a text of 70000 bytes"):
        codec.decode_request(long, "quick")


def test_who_asks_has_a_name_of_200_characters_at_most() -> None:
    request = codec.encode_request("status", {}, "anna@" + "y" * 60_000)
    assert len(codec.decode_request(request, "quick")[2]) == 200


def test_a_name_in_the_wrong_capitals_is_the_nearest_there_is() -> None:
    assert errors.nearest("kp", ("Kd1", "Kp1", "q")) == ["Kp1"]
    assert errors.nearest("kd1", ("qd1", "Kd1"), 2) == ["Kd1", "qd1"]
    assert errors.did_you_mean("DELAY", ("gain", "delay")).startswith("did you mean delay?")


NEW = """
import sys, threading
from zendsp_protocol import codec, messages as m
from zendsp_protocol.states import ProgramState
sys.setswitchinterval(1e-6)
trip = m.Trip(reason="stop", tick=1, text="STOP")
told = codec.encode_result(m.Status(state=ProgramState.STOPPED, trip=trip, timing=m.Timing()))
begin = threading.Barrier(12)
def read():
    begin.wait()
    assert codec.decode_reply(told, m.Status).trip == trip
threads = [threading.Thread(target=read) for _ in range(12)]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
"""


def test_several_threads_may_meet_a_type_for_the_first_time_together() -> None:
    """`zendsp ls` of many targets on a busy computer had ended with SIGSEGV."""
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", NEW], capture_output=True, text=True)
        assert done.returncode == 0, (done.returncode, done.stderr)


def test_a_request_that_no_target_takes_in_is_not_sent() -> None:
    """When it was sent and not answered, that looked like a target that is gone."""
    with pytest.raises(Refused, match=r"update of 80 MB was not sent: .* upload"):
        codec.encode_request("update", {"values": {"tab": np.zeros(10_000_000)}}, "me")


@pytest.mark.parametrize(
    ("dtype", "size", "columns"), [("<f8", 12, 1), ("<f8", 16, 3), ("<f8", 16, 0), ("<i4", 4, -1)]
)
def test_packed_values_that_fill_no_whole_rows_are_refused(
    dtype: str, size: int, columns: int
) -> None:
    words = f"of {size} bytes holds no whole number of rows of {columns} {dtype}"
    with pytest.raises(ValueError, match=words):
        from_wire(Packed(dtype, bytes(size), columns))
