"""Repeated requests take a shorter way, with the same replies, refusals and log."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable
from typing import Any

import hypothesis as hyp
import pytest
from desk import Desk, desk_of
from hypothesis import strategies as st
from samples import run
from waiting import until

from zendsp_protocol import codec, verbs
from zendsp_protocol import messages as m
from zendsp_protocol.errors import Refused, RunnerDied, VariableError, ZendspError
from zendsp_target.runtime import Runtime

Make = Callable[..., Runtime]

PROGRAM = """
#include "isr.h"
static double a = 1.0, b = 2.0;
static double list[3];
static int32_t n, k;
void UserInit(void) {
    PARAMETER(a, 1.0, "V", -10.0, 10.0, ""); PARAMETER(b, 2.0, "", NO_MIN, NO_MAX, ""); PARAMETER(k, 0, "", NO_MIN, NO_MAX, "");
    SIGNAL(list, "", ""); SIGNAL(n, "", "");
}
void UserISR_INT2(void) { n++; list[1] = 2.0 * a; }
void UserBackground(void) {}
"""  # noqa: E501
TWINS = """
#include "isr.h"
static double a, b, c;
void UserInit(void) {
    PARAMETER(a, 0, "", NO_MIN, NO_MAX, ""); PARAMETER(b, 0, "", NO_MIN, NO_MAX, ""); PARAMETER(c, 0, "", NO_MIN, NO_MAX, "");
}
void UserISR_INT2(void) {}
void UserBackground(void) {}
"""  # noqa: E501
OTHER = """
#include "isr.h"
static double first[7], a = 5.0;
void UserInit(void) { SIGNAL(first, "", ""); PARAMETER(a, 5.0, "V", -1.0, 1000.0, ""); }
void UserISR_INT2(void) {}
void UserBackground(void) {}
"""


def samples(runtime: Runtime, count: int = 1) -> None:
    run(runtime, count)


def test_a_repeated_write_or_read_gets_the_reply_that_the_first_one_got(make_runtime: Make) -> None:
    runtime = make_runtime(PROGRAM)
    desk = desk_of(runtime)
    names = ["list[1]", "b", "a", "b"]
    for k in range(1, 6):
        assert desk.write(a=k / 4) == 2 * k - 1
        assert desk.write("you", b=-k / 3) == 2 * k
        samples(runtime)
        expected = m.Reading(tick=k - 1, values={"list[1]": k / 2, "b": -k / 3, "a": k / 4})
        found = desk.ask("read", names=names)
        assert found == expected and list(found.values) == list(expected.values)
        assert desk.ask("read", names=["a"]) == m.Reading(tick=k - 1, values={"a": k / 4})
    assert desk.again == 4 * 4  # all but the first of each
    shown = [(c.tick, c.name, c.old, c.new, c.author) for c in runtime.log()]
    assert shown[:4] == [
        (0, "a", 1.0, 0.25, "me"),
        (0, "b", 2.0, -1 / 3, "you"),
        (1, "a", 0.25, 0.5, "me"),
        (1, "b", -1 / 3, -2 / 3, "you"),
    ]
    assert len(shown) == 10 and all(abs(c.host_time - time.time()) < 60.0 for c in runtime.log())


def test_a_reading_after_an_acknowledged_update_is_never_of_the_sample_before(
    make_runtime: Make,
) -> None:
    runtime = make_runtime(PROGRAM, clock="real", realtime=False)
    desk = desk_of(runtime)
    runtime.start()
    for k in range(50):
        sequence = desk.write(b=float(k))
        tick = runtime.wait_applied(sequence, 10.0)
        found = desk.ask("read", names=["b"])
        assert found.tick >= tick and found.values == {"b": float(k)}
    assert desk.again > 49


@pytest.mark.parametrize("wrong", [10.5, -11.0, float("nan"), float("inf")])
def test_a_repeated_write_of_a_wrong_value_is_refused_in_the_same_words(
    make_runtime: Make, wrong: float
) -> None:
    runtime = make_runtime(PROGRAM)
    desk = desk_of(runtime)
    first = desk.refusal(a=wrong)
    assert first.startswith("VariableError: a: ")
    for k in range(3):
        assert desk.write(a=float(k)) == k + 1
        assert desk.refusal(a=wrong) == first
    samples(runtime)
    assert [c.new for c in runtime.log()] == [0.0, 1.0, 2.0] and desk.again == 2


@pytest.mark.parametrize("wrong", [float("nan"), float("inf"), -float("inf")])
def test_what_is_not_finite_is_refused_also_where_there_are_no_limits(
    make_runtime: Make, wrong: float
) -> None:
    desk = desk_of(make_runtime(PROGRAM))
    for _ in range(2):
        assert (
            desk.refusal(b=wrong)
            == f"VariableError: b: {wrong} is not a finite number; nothing was written"
        )
        desk.write(b=1.0)


def test_a_new_program_is_read_and_written_by_its_own_places_and_limits(make_runtime: Make) -> None:
    runtime = make_runtime(PROGRAM)
    desk, other = desk_of(runtime), runtime.compile({"other.c": OTHER})
    for k in range(3):
        desk.write(a=float(k))
        samples(runtime)
        desk.ask("read", names=["a"])
    desk.write(b=1.0)
    runtime.load(other.key)  # behind the back of those who could forget
    with pytest.raises(VariableError, match="b"):
        desk.write(b=1.0)
    again = desk.again
    assert desk.ask("read", names=["a"]).values == {"a": 5.0}
    assert desk.write(a=999.0) == 5  # numbers of updates are never given anew
    assert "outside" in desk.refusal(a=-10.0) and desk.again == again
    desk.ask("load", key=other.key)
    for k in range(1, 4):
        assert desk.write(a=float(k)) == 5 + k
    assert desk.again == again + 2
    desk.ask("unload")
    for ask in (lambda: desk.write(a=1.0), lambda: desk.ask("read", names=["a"])):
        with pytest.raises(Refused, match="no program"):
            ask()


def test_a_repeated_write_is_refused_while_another_host_commands(make_runtime: Make) -> None:
    runtime = make_runtime(PROGRAM)
    desk = desk_of(runtime)
    for by in ("me", "you"):
        for k in range(2):
            desk.write(by, a=float(k))
    desk.ask("drive", "you", action="take")
    assert "exclusive right" in desk.refusal("me", a=3.0)
    assert desk.write("you", a=4.0) == 5 and desk.again == 3
    desk.ask("drive", "you", action="release")
    assert desk.write("me", a=5.0) == 6
    samples(runtime)
    assert [c.new for c in runtime.log()] == [0.0, 1.0, 0.0, 1.0, 4.0, 5.0]


def test_only_requests_that_differ_in_numbers_alone_take_the_short_way(make_runtime: Make) -> None:
    runtime = make_runtime(PROGRAM)
    desk = desk_of(runtime)
    samples(runtime)
    for _ in range(3):
        desk.write(a=1)
        desk.write(k=3)
        desk.write(a=1.0, k=2.0)
        desk.ask("write", values={"a": 1.0}, at_tick=0)
        desk.ask("update", values={"a": 1.0}, fade=0.5)
        samples(runtime)
        desk.ask("read", names=["n"])
        desk.ask("read", names=["list", "a"])
    assert desk.again == 0


def test_requests_that_begin_alike_and_are_as_long_are_told_apart(make_runtime: Make) -> None:
    desk = desk_of(make_runtime(TWINS))
    for k in range(3):
        desk.write(a=float(k), b=1.0 + k)
        desk.write(a=9.0, c=2.0 + k)
        desk.ask("update", values={"a": float(k), "b": 1.0 + k})
    assert desk.again == 2 + 2
    found = desk.ask("read", names=["a", "b", "c"])
    assert found.values == {"a": 2.0, "b": 3.0, "c": 4.0}
    desk.write(a=0.5)
    # another author, behind the value
    body = {"v": codec.PROTOCOL, "verb": "write", "args": {"values": {"a": 0.5}}, "by": "me"}
    request, other = codec.encode(body), codec.encode({**body, "by": "us"})
    repeats = desk.repeats["quick"]
    repeats.learn(request, *codec.decode_request(request, "quick"), "me")
    assert repeats.answer(request) is not None and repeats.answer(other) is None


def test_a_repeated_reading_sees_the_write_before_it(make_runtime: Make) -> None:
    runtime = make_runtime(PROGRAM, clock="real", realtime=False)
    desk = desk_of(runtime)
    runtime.start()
    for k in range(300):  # its number takes more bytes
        number = desk.write(b=float(k))
        assert desk.ask("read", names=["b"], after=number).values == {"b": float(k)}
    assert desk.again >= 299, "the writes, and readings where the sample came soon"
    repeated = desk.again
    assert desk.ask("read", names=["b"], after=number).values == {"b": 299.0}
    assert desk.again == repeated + 1, "what can be read already"
    for unknown in (10**6, 2**40):
        assert desk.ask("read", names=["b"], after=unknown).values == {"b": 299.0}


def test_a_repeated_update_is_acknowledged_with_the_sample_at_which_it_took_effect(
    make_runtime: Make,
) -> None:
    runtime = make_runtime(PROGRAM)
    desk = desk_of(runtime)
    for k in range(1, 6):
        applied = desk.ask("update", values={"a": k / 4, "b": -k / 3})
        assert applied == m.Applied(sequence=k, tick=k - 1)
        samples(runtime)
    assert desk.again == 4
    logged = [(c.tick, c.name, c.new) for c in runtime.log()]
    assert logged[-2:] == [(4, "a", 1.25), (4, "b", -5 / 3)]
    desk.ask("drive", "you", action="take")
    with pytest.raises(Refused, match="exclusive right"):
        desk.ask("update", values={"a": 0.0, "b": 0.0})


def test_a_repeated_write_for_a_runner_that_is_gone_says_how_it_died(make_runtime: Make) -> None:
    runtime = make_runtime(PROGRAM)
    desk = desk_of(runtime)
    for _ in range(3):
        desk.write(a=1.0)
    os.kill(runtime.runner_pid(), signal.SIGKILL)
    until(lambda: not runtime.runner_pid(), "it is gone")
    with pytest.raises(RunnerDied, match="SIGKILL"):
        desk.write(a=2.0)
    assert desk.again == 2


def test_repeated_writes_of_several_threads_are_each_applied_once_and_numbered(
    make_runtime: Make,
) -> None:
    runtime = make_runtime(PROGRAM, clock="real", realtime=False)
    service = desk_of(runtime).service
    runtime.start()
    told: list[tuple[int, float]] = []

    def tune(number: int) -> None:
        desk = Desk(service)  # one for each thread, as in the server
        for k in range(300):
            value = number + k / 1000
            while True:
                try:
                    told.append((desk.write(f"host{number}", b=value), value))
                    break
                except Refused:  # too many wait for the next sample
                    time.sleep(0.001)
            assert desk.ask("read", names=["b"]).tick >= 0
        assert desk.again > 300

    threads = [threading.Thread(target=tune, args=(number,)) for number in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60.0)
    told.sort()
    assert [sequence for sequence, _ in told] == list(range(1, 901))
    runtime.wait_applied(900, 10.0)
    log = runtime.log()
    assert sorted(float(str(c.new)) for c in log) == sorted(value for _, value in told)
    assert all(c.author == f"host{int(float(str(c.new)))}" for c in log)


class LongWay(Desk):
    """A desk at which no request is known again."""

    def learn(self, request: bytes, verb: verbs.Verb, args: Any, author: str) -> None:
        pass


NAMES = ("a", "b", "k", "list[1]", "list", "n", "nope")
VALUES = (
    0.0,
    -0.0,
    1.5,
    -9.9,
    10.0,
    10.1,
    -1e300,
    5e-324,
    float("nan"),
    float("inf"),
    3,
    -3,
    2**40,
    True,
    [1.0, 2.0, 3.0],
    [True],
)
ASKED = st.one_of(
    st.tuples(
        st.just("write"),
        st.dictionaries(
            st.sampled_from(NAMES[:3]), st.sampled_from(VALUES[:4]), min_size=1, max_size=1
        ),
    ),
    st.tuples(
        st.just("write"),
        st.dictionaries(st.sampled_from(NAMES), st.sampled_from(VALUES), min_size=1, max_size=3),
    ),
    st.tuples(
        st.sampled_from(["write", "update"]),
        st.dictionaries(st.sampled_from(NAMES[:2]), st.sampled_from(VALUES[:6]), min_size=1),
    ),
    st.tuples(
        st.sampled_from(["read", "see"]),
        st.lists(st.sampled_from(NAMES[:4]), min_size=1, max_size=3),
    ),
    st.tuples(st.just("drive"), st.sampled_from(["take", "release"])),
    st.tuples(st.just("samples"), st.integers(1, 3)),
)
ARGUMENTS: dict[str, Callable[[Any], dict[str, Any]]] = {
    "write": lambda values: {"values": values},
    "update": lambda values: {"values": values},
    "read": lambda names: {"names": names},
    "drive": lambda action: {"action": action},
}


def outcome(desk: Desk, verb: str, by: str, given: Any) -> object:
    """What a host is told: the result, to the last bit, or the refusal; with the update in effect.
    """
    if verb == "samples":
        return samples(desk.service.runtime, given)  # type: ignore[arg-type, func-returns-value]
    try:
        if verb == "see":  # all that was written
            return repr(desk.ask("read", by, names=given, after=desk.written))
        result = desk.ask(verb, by, **ARGUMENTS[verb](given))
    except ZendspError as error:
        return type(error), str(error)
    if verb in ("write", "update"):
        desk.written = result.sequence
        desk.service.runtime.wait_applied(result.sequence, 10.0)
    return repr(result)


def test_random_requests_are_answered_alike_and_do_the_same_on_either_way(
    make_runtime: Make,
) -> None:
    desks = desk_of(make_runtime(PROGRAM)), desk_of(make_runtime(PROGRAM), LongWay)

    # One pair of programs for all of them: what differs once is found in the log at the latest.
    @hyp.settings(
        max_examples=60, deadline=None, derandomize=True, database=None, phases=[hyp.Phase.generate]
    )
    @hyp.given(st.lists(st.tuples(ASKED, st.sampled_from(["me", "you"])), min_size=10, max_size=30))
    def ask(requests: list[tuple[tuple[str, Any], str]]) -> None:
        for (verb, given), by in requests:
            short, long = (outcome(desk, verb, by, given) for desk in desks)
            assert short == long, (verb, by, given)

    ask()
    short, long = (
        [(c.tick, c.name, str(c.old), str(c.new), c.author) for c in desk.service.runtime.log()]
        for desk in desks
    )
    assert short == long and len(short) > 100
    assert desks[0].again > 100 and desks[1].again == 0
