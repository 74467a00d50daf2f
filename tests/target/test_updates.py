"""Synchronous updates under hostile writers: never mixed, never torn, whoever dies."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from samples import run

from zendsp_protocol.errors import Refused, TooSoon, VariableError
from zendsp_target.api import AcquireConfig
from zendsp_target.runtime import Runtime
from zendsp_target.runtime.memory.layout import layout

Make = Callable[..., Runtime]

# Every update gives all 32 scalars, the array and the table the same number; the ISR counts samples
# in which two of them differ.
WITNESS = (
    '#include "isr.h"\n'
    + "static double "
    + ", ".join(f"p{i}" for i in range(32))
    + """;
static double list[32];
static table ref;
static int32_t mixed, alone, changes;
static double before;
void UserInit(void) {
"""
    + "\n".join(f'    PARAMETER(p{i}, 0.0, "", NO_MIN, NO_MAX, "");' for i in range(32))
    + """
    PARAMETER(list, 0.0, "", NO_MIN, NO_MAX, "");
    PARAMETER(alone, 0, "", NO_MIN, NO_MAX, "");
    TABLE(ref, 64, 1, "", "");
    SIGNAL(mixed, "", ""); SIGNAL(changes, "", "");
}
void UserISR_INT2(void) {
    const double all[32] = {"""
    + ", ".join(f"p{i}" for i in range(32))
    + """};
    bool differs = false;
    for (int i = 0; i < 32; i++)
        differs = differs || all[i] != p0 || list[i] != p0;
    for (int32_t i = 0; i < ref.rows; i++)
        differs = differs || ref.data[i] != p0;
    mixed += differs;
    changes += p0 != before;
    before = p0;
}
"""
)


def values(number: float, with_table: bool) -> dict[str, object]:
    """One update of everything."""
    update: dict[str, object] = {f"p{i}": number for i in range(32)}
    update["list"] = np.full(32, number)
    if with_table:
        update["ref"] = np.full((64, 1), number)
    return update


def test_a_million_samples_under_hostile_writers_mix_no_update(make_runtime: Make) -> None:
    """One writer updates 32 scalars, an array and a table; two more crowd it; a fourth scribbles
    over uncommitted batches.
    """
    runtime = make_runtime(WITNESS)
    stop = threading.Event()
    sent = [0, 0, 0]

    def everything() -> None:
        while not stop.is_set():
            try:
                runtime.write(values(float(sent[0]), with_table=True),
                    "a")  # type: ignore[arg-type]
            except Refused:
                continue  # the last table is not in effect yet
            sent[0] += 1

    def bystander(which: int) -> None:
        while not stop.is_set():
            try:
                runtime.write({"alone": which}, str(which))
                sent[which] += 1
            except Refused:
                continue

    def garbage() -> None:
        """Scribble over batches that were never committed, as a writer that dies half-way leaves
        them.
        """
        session = runtime.programs.session
        assert session is not None
        flights = session.flights
        memory = np.frombuffer(session.process.data_file.map, dtype=np.uint8)
        noise = np.random.default_rng(1)
        control = session.control
        while not stop.is_set():
            with flights.lock:
                slot = flights.free[0] if flights.free else None
                if slot is None:
                    continue
                start = int(control.batch_offset) + slot * int(control.batch_stride)
                memory[start + 8 : start + int(control.batch_stride)] = noise.integers(
                    0, 256, int(control.batch_stride) - 8, dtype=np.uint8
                )

    threads = [threading.Thread(target=everything), threading.Thread(target=garbage)]
    threads += [threading.Thread(target=bystander, args=(i,)) for i in (1, 2)]
    runtime.start()
    for thread in threads:
        thread.start()
    session = runtime.programs.session
    assert session is not None
    try:
        while session.tick < 1_000_000 or sent[0] < 1000:
            session.require_alive()  # or says how it died
            threading.Event().wait(0.02)
    finally:
        stop.set()
        for thread in threads:
            thread.join()
    runtime.pause()
    found = runtime.read(["mixed", "changes", "tick"])[1]
    assert found["tick"] >= 1_000_000 - 1
    assert found["mixed"] == 0
    assert found["changes"] >= 900  # the test has power: updates did arrive while it ran
    assert runtime.status().state == "paused"


def test_many_readers_see_whole_samples_while_the_loop_runs_free(make_runtime: Make) -> None:
    """The loop copies 260 kB for each sample, which takes most of its time: a reader nearly always
    comes while it does, however the computer shares out its processors.
    """
    still = [f"still{k}" for k in range(8)]
    code = f"""
    #include "isr.h"
    static double {", ".join(f"{name}[4096]" for name in still)}, a[64];
    void UserInit(void) {{
        {" ".join(f'SIGNAL({name}, "", "");' for name in still)} SIGNAL(a, "", "");
    }}
    void UserISR_INT2(void) {{ for (int i = 0; i < 64; i++) a[i] = (double)SAMPLE_TICK; }}
    """
    runtime = make_runtime(code)
    runtime.start()
    torn: list[object] = []

    def reader() -> None:
        for _ in range(500):
            tick, found = runtime.read(["a", "tick"])
            a = np.asarray(found["a"])
            if np.any(a != tick) or found["tick"] != tick:
                torn.append((tick, a))

    threads = [threading.Thread(target=reader) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert torn == []


def test_a_copy_that_was_overtaken_by_the_loop_is_made_again() -> None:
    """The reader's half of the seqlock, with samples so large that each copy takes milliseconds and
    is nearly always overtaken.
    """
    ffi, lib = layout()
    words, rewrites = 2 << 20, 60
    # sequence, tick, values; every sample in the same place: the stride is 0
    slot = np.zeros(2 + words, dtype=np.uint64)
    newest = np.zeros(1, dtype=np.uint64)
    over = threading.Event()

    def loop() -> None:  # as `publish` of loop.c
        for n in range(rewrites):
            slot[0] = 2 * n + 1
            slot[1] = n
            slot[2:] = n
            slot[0] = 2 * n + 2
            newest[0] = n + 1
            time.sleep(0.002)
        over.set()

    values = np.empty(words, dtype=np.uint64)
    tick = ffi.new("uint64_t *")
    arguments = (
        ffi.cast("uint64_t *", ffi.from_buffer(newest)),
        ffi.cast("unsigned char *", ffi.from_buffer(slot)),
        0,
        0,
        8 * words,
        ffi.cast("unsigned char *", ffi.from_buffer(values)),
        tick,
    )
    thread = threading.Thread(target=loop)
    thread.start()
    while not over.is_set():
        if lib.monitor_snapshot(*arguments):
            assert np.all(values == tick[0]), "rows of two samples"
    thread.join()
    assert lib.monitor_snapshot(*arguments) and np.all(values == rewrites - 1)


def test_updates_for_later_samples_do_not_hold_up_earlier_ones(make_runtime: Make) -> None:
    runtime = make_runtime(WITNESS)
    late = runtime.write({"alone": 3}, "me", at_tick=300)
    early = runtime.write({"alone": 1}, "me", at_tick=100)
    same = runtime.write({"alone": 2}, "me", at_tick=100)
    runtime.acquire_configure(0, AcquireConfig(("alone",), seconds=0.4))
    runtime.acquire_start(0)
    run(runtime, 400)
    assert [runtime.wait_applied(sequence, 10.0) for sequence in (early, same, late)] == [
        100, 100, 300,
    ]
    rows = runtime.acquire_read(0, 0, 400)[:, 0]
    assert np.array_equal(
        rows, np.where(np.arange(400) < 100, 0.0, np.where(np.arange(400) < 300, 2.0, 3.0))
    )


def test_updates_for_later_samples_leave_room_for_those_of_the_next(make_runtime: Make) -> None:
    """Otherwise an update for a far future would keep all others from writing."""
    runtime = make_runtime(WITNESS)
    sequences = []
    with pytest.raises(Refused, match="64 updates wait for a later sample, or fade, already"):
        for number in range(1000):
            sequences.append(runtime.write({"alone": number}, "me", at_tick=50))
    assert len(sequences) == 64
    now = [runtime.write({"alone": -1}, "another") for _ in range(64)]
    run(runtime, 200)
    ticks = [runtime.wait_applied(sequence, 10.0) for sequence in sequences]
    assert ticks == sorted(ticks)
    assert set(ticks) == {50}
    # a busy computer hands some of them over a sample or two later
    assert max(runtime.wait_applied(sequence, 10.0) for sequence in now) < 50
    assert runtime.read(["alone"])[1]["alone"] == len(sequences) - 1
    runtime.wait_applied(runtime.write({"alone": -1}, "me"), 10.0)


def test_elements_and_types_are_written_as_declared(make_runtime: Make) -> None:
    code = """
    #include "isr.h"
    static double d[3] = {1.5, 2.5, 3.5};
    static float f = 0.0f;
    static int32_t i;
    static bool b[2];
    void UserInit(void) {
        PARAMETER_ARRAY(d, "rad", -10.0, 10.0, "array"); PARAMETER(f, 0.25, "V", -1.0, 1.0, "single");
        PARAMETER(i, -7, "", -100, 100, "whole"); PARAMETER(b, true, "", 0, 1, "flags");
    }
    void UserISR_INT2(void) {}
    """  # noqa: E501
    runtime = make_runtime(code)
    infos = {info.name: info for info in runtime.variables()}
    assert [
        (n, v.type, v.length, v.unit, v.minimum, v.maximum, v.description) for n, v in infos.items()
    ] == [
        ("d", "double", 3, "rad", -10.0, 10.0, "array"),
        ("f", "float", 1, "V", -1.0, 1.0, "single"),
        ("i", "int32", 1, "", -100.0, 100.0, "whole"),
        ("b", "bool", 2, "", 0.0, 1.0, "flags"),
    ]
    assert np.array_equal(np.asarray(infos["d"].initial), [1.5, 2.5, 3.5])
    assert (infos["f"].initial, infos["i"].initial) == (0.25, -7)
    assert np.array_equal(np.asarray(infos["b"].initial), [True, True])
    assert len({info.address for info in infos.values()}) == 4
    runtime.wait_applied(
        runtime.write({"d[1]": -2.0, "f": 0.5, "i": 42, "b[0]": False}, "me"), 10.0
    )
    _, found = runtime.read(["d", "d[1]", "f", "i", "b"])
    assert np.array_equal(np.asarray(found["d"]), [1.5, -2.0, 3.5])
    assert (found["d[1]"], found["f"], found["i"]) == (-2.0, 0.5, 42)
    assert np.array_equal(np.asarray(found["b"]), [False, True])
    assert isinstance(found["i"], int)


LIMITED = """
#include "isr.h"
static double a = 1.0, b = 2.0;
static double list[3];
static int32_t n;
void UserInit(void) {
    PARAMETER(a, 1.0, "V", -10.0, 10.0, ""); PARAMETER(b, 2.0, "", NO_MIN, NO_MAX, "");
    SIGNAL(list, "", ""); SIGNAL(n, "", "");
}
void UserISR_INT2(void) { n++; list[1] = a; }
"""


def test_an_update_of_the_same_names_is_checked_and_logged_each_time_as_the_first(
    make_runtime: Make,
) -> None:
    runtime = make_runtime(LIMITED)
    wrong: list[dict[str, object]] = [
        {"a": 10.5, "b": 0.0}, {"a": True, "b": 0.0}, {"a": float("nan"), "b": 0.0},
        {"a": 0.0, "b": float("inf")}, {"a": "1", "b": 0.0}, {"a": [1.0, 2.0], "b": 0.0},
    ]

    def refusals() -> list[str]:
        said = []
        for values in wrong:
            with pytest.raises(VariableError) as refusal:
                runtime.write(values, "me")  # type: ignore[arg-type]
            said.append(str(refusal.value))
        return said

    first = refusals()
    for k in range(3):
        runtime.wait_applied(runtime.write({"a": float(k), "b": -float(k)}, "me"), 10.0)
        assert refusals() == first
    runtime.wait_applied(runtime.write({"a": 7, "b": 1}, "you"), 10.0)
    assert runtime.read(["b", "a"])[1] == {"b": 1.0, "a": 7.0}
    shown = [(c.name, c.old, c.new, c.author) for c in runtime.log()]
    pairs = [(1.0, 2.0), (0.0, -0.0), (1.0, -1.0), (2.0, -2.0)]
    expected = [
        line
        for (a, b), (a2, b2) in pairwise(pairs)
        for line in (("a", a, a2, "me"), ("b", b, b2, "me"))
    ]
    assert shown == [*expected, ("a", 2.0, 7.0, "you"), ("b", -2.0, 1.0, "you")]
    with pytest.raises(Refused, match="at_tick -1"):
        runtime.write({"a": 1.0, "b": 1.0}, "me", at_tick=-1)


def test_a_reading_of_the_same_names_is_fresh_and_in_the_order_asked_for(
    make_runtime: Make,
) -> None:
    runtime = make_runtime(LIMITED)
    for k in range(1, 4):
        runtime.wait_applied(runtime.write({"a": float(k)}, "me"), 10.0)
        run(runtime, 1)
        tick, found = runtime.read(["n", "list", "a", "list[1]"])
        assert list(found) == ["n", "list", "a", "list[1]"]
        assert (tick, found["n"], found["a"], found["list[1]"]) == (k - 1, k, k, k)
        assert np.array_equal(np.asarray(found["list"]), [0.0, k, 0.0])


# Half of each sample passes between the update and the picture of the sample that others read.
SLOW = """
#include "isr.h"
#include <time.h>
static double a;
void UserInit(void) { PARAMETER(a, 0.0, "", NO_MIN, NO_MAX, ""); }
void UserISR_INT2(void) {
    struct timespec begin, now;
    clock_gettime(CLOCK_MONOTONIC, &begin);
    do
        clock_gettime(CLOCK_MONOTONIC, &now);
    while ((now.tv_sec - begin.tv_sec) * 1e3 + (now.tv_nsec - begin.tv_nsec) * 1e-6 < 5.0);
}
"""


def test_whoever_has_waited_for_an_update_reads_its_values_however_long_a_sample_takes(
    make_runtime: Make,
) -> None:
    runtime = make_runtime(SLOW, rate_hz=100.0, clock="real", realtime=False)
    runtime.start()
    for k in range(1, 11):
        tick = runtime.wait_applied(runtime.write({"a": float(k)}, "me"), 10.0)
        read_at, found = runtime.read(["a"])
        assert read_at >= tick and found == {"a": float(k)}


TABLES = """
#include "isr.h"
static const table *a, *b;
static double x, y;
void UserInit(void) { TABLE(a, 8, 1, "", ""); TABLE(b, 8, 1, "", ""); PARAMETER(x, 0, "V", -1.0, 1.0, ""); }
void UserISR_INT2(void) { y = a->rows + b->rows + x; }
"""  # noqa: E501


def test_an_update_that_is_refused_for_one_table_leaves_the_bank_of_the_other_alone(
    make_runtime: Make,
) -> None:
    runtime = make_runtime(TABLES)
    rows = {k: np.full((4, 1), float(k)) for k in range(5)}
    runtime.wait_applied(runtime.write({"a": rows[1], "b": rows[1]}, "me"), 10.0)
    runtime.write({"b": rows[2]}, "me", at_tick=50)
    with pytest.raises(TooSoon, match=r"b: its last download is not in effect yet"):
        runtime.write({"a": rows[3], "b": rows[3]}, "me")
    with pytest.raises(VariableError, match=r"x: 2 V is outside its limits"):
        runtime.write({"a": rows[3], "x": 2.0}, "me")
    runtime.write({"a": rows[4]}, "me", at_tick=60)
    # what the loop uses now is never written over
    assert np.array_equal(runtime.read(["a"])[1]["a"], rows[1])
    run(runtime, 100)
    found = runtime.read(["a", "b"])[1]
    assert np.array_equal(found["a"], rows[4]) and np.array_equal(found["b"], rows[2])
