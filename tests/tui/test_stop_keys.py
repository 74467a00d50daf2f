"""Which bytes of a terminal are STOP, and which are not."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest
from textual.events import MouseDown
from waiting import until

from zendsp.tui import stop_process, stopper

F9 = b"\x1b[20~"
SERVE = "{}, {}, False"


def _stops(*parts: bytes, web: bool = False) -> bool:
    return any(
        stop_process.is_stop(press) for press in _presses(*parts, web=web) if isinstance(press, str)
    )


def _presses(*parts: bytes, web: bool = False) -> list[object]:
    presses = stop_process.Presses(web)
    return [press for part in parts for press in presses.find(part)]


@pytest.mark.parametrize(
    "parts",
    [
        (F9,),
        (b"\x1b[2", b"0~"),
        (b"\x1b\x1b[20~",),
        (b"\x1b[20;2~",),
        (b"\x1b[20;1:1~",),
        (b"\0",),
        (b"\x1b[32;5u",),
        (b"s" + F9 + b"s",),
    ],
)
def test_the_f9_sequences_of_all_terminals_stop(parts: tuple[bytes, ...]) -> None:
    assert _stops(*parts)


@pytest.mark.parametrize(
    "part", [b"\x1b[200~" + F9 + b"\x1b[201~", b"\x1b[19~", b"\x1b[21~", b"20~", b"9"]
)
def test_other_keys_and_pasted_text_do_not_stop(part: bytes) -> None:
    assert not _stops(part)


def test_f9_in_the_packets_of_a_web_page_stops() -> None:
    assert _stops(b"D" + len(F9).to_bytes(4, "big") + F9, web=True)


def test_a_paste_that_never_ends_does_not_take_stop_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop_process, "PASTE_S", 0.01)
    presses = stop_process.Presses(False)
    assert not list(presses.find(b"\x1b[200~abc"))
    time.sleep(0.02)
    assert "f9" in presses.find(F9)


@pytest.mark.parametrize("web", [False, True])
def test_f9_again_and_again_stops_where_the_end_of_a_paste_was_lost(web: bool) -> None:
    """Each press renewed the two seconds after which a paste is over: 16 stopped nothing."""
    presses = stop_process.Presses(web)

    def read(data: bytes) -> list[object]:
        return list(presses.find(b"D" + len(data).to_bytes(4, "big") + data if web else data))

    assert "f9" not in read(b"\x1b[200~abc" + F9)
    assert "f9" in read(F9)


@pytest.mark.parametrize(
    ("report", "stops"),
    [
        (b"\x1b[<0;68;1M", True),
        (b"\x1b[<0;80;3M", True),
        (b"\x1b[<0;67;1M", False),
        (b"\x1b[<0;70;4M", False),
        (b"\x1b[<2;70;2M", False),
        (b"\x1b[<0;70;2m", False),
        (b"\x1b[<35;70;2M", False),
        (b"\x1b[<64;70;2M", False),
    ],
)
@pytest.mark.parametrize("web", [False, True])
def test_a_click_stops_where_the_red_field_is(report: bytes, stops: bool, web: bool) -> None:
    field = stop_process.Field(67, 0, 13, 3)
    sent = b"D" + len(report).to_bytes(4, "big") + report if web else report
    assert (
        any(field.holds(press) for press in _presses(sent, web=web) if isinstance(press, MouseDown))
        is stops
    )


def test_a_click_that_waits_for_the_process_to_begin_stops() -> None:
    control_in, control = os.pipe()
    verdicts, verdicts_out = os.pipe()
    os.write(control, b"imi\n@ 67 0 13 3\n")  # the field was told before it could be seen
    process = subprocess.Popen(
        [sys.executable, "-c", stopper.CALL.format(b"", SERVE.format(control_in, verdicts_out))],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        pass_fds=(control_in, verdicts_out),
    )
    os.close(verdicts_out)
    try:
        assert process.stdin is not None
        process.stdin.write(b"\x1b[<0;70;2M\x1b[<0;70;2m")
        process.stdin.close()
        assert b"STOP asked" in os.read(verdicts, 4096)
    finally:
        process.kill()
        process.wait()
        for pipe in (control_in, control, verdicts):
            os.close(pipe)


def _late(escapes: stop_process.Escapes, *parts: bytes) -> list[object]:
    """The keys that an application finds that reads all of it at once, when it comes to it."""
    return _presses(b"".join(map(escapes.told_apart, parts)))


class NoPage:
    """Links of a target whose stop page cannot be read."""

    name, target = "imi", None

    def page(self) -> None:
        raise OSError("gone")


def test_a_stop_page_that_cannot_be_read_leaves_stop_to_the_link(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """F9 is pressed as the target's page disappears: the process of the keys must survive and
    report it.
    """
    monkeypatch.setattr(stop_process, "INSIST_S", 0.0)
    told: list[tuple[object, ...]] = []
    stop_process.Stops(NoPage(), lambda *said: told.append(said)).press()  # type: ignore[arg-type]
    until(lambda: len(told) == 2, "a verdict")
    assert [state for state, *_ in told] == ["asked", "not stopped"]


def test_an_escape_and_the_key_after_it_are_two_keys_however_late_they_are_read() -> None:
    escapes = stop_process.Escapes(web=False)
    assert _late(escapes, b"\x1b", b"o", b"\x1b", b"\r", b"\x1b\x1b", b"") == [
        *("escape", "o", "escape", "enter", "escape", "escape")
    ]


def test_a_sequence_that_comes_in_two_parts_is_one_key() -> None:
    assert _late(stop_process.Escapes(web=False), b"\x1b", b"[20~", b"\x1b", b"OP") == ["f9", "f1"]


def test_an_escape_that_nothing_follows_is_handed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stop_process, "ESCAPE_S", 0.0)
    escapes = stop_process.Escapes(web=False)
    assert escapes.told_apart(b"s\x1b") == b"s"
    until(escapes.alone, "nothing followed")
    assert _late(escapes, b"", b"o") == ["escape", "o"]
    assert not escapes.alone()


def test_the_escape_of_a_page_is_a_packet_of_its_own() -> None:
    page = [b"D" + len(key).to_bytes(4, "big") + key for key in (b"\x1b", b"o", F9)]
    handed = stop_process.Escapes(web=True).told_apart(b"".join(page))
    assert _presses(handed, web=True) == ["escape", "o", "f9"]


Guarded = tuple[stopper.Stopper, list[str]]  # and what it told


@pytest.fixture
def keys_process(monkeypatch: pytest.MonkeyPatch) -> Iterator[Guarded]:
    """A process of the keys that has begun; what it is told to do takes an hour to be too late."""
    monkeypatch.setattr(stopper, "SILENT_S", 3600.0)
    typed, keyboard = os.pipe()
    kept = os.dup(0)
    os.dup2(typed, 0)
    os.close(typed)
    told: list[str] = []
    guard = stopper.Stopper()
    guard.listen(lambda state, *_: told.append(state))
    try:
        guard.stop()  # of no target
        until(lambda: "asked" in told, "it has begun")
        yield guard, told
    finally:
        guard.close()
        os.dup2(kept, 0)
        os.close(kept)
        os.close(keyboard)


@pytest.mark.parametrize("states", [None, {"S"}], ids=["frozen", "sleeps, as if for another"])
def test_a_process_of_the_keys_that_does_nothing_is_not_waited_for(
    keys_process: Guarded, monkeypatch: pytest.MonkeyPatch, states: set[str] | None
) -> None:
    if states:
        monkeypatch.setattr(stopper, "_states", lambda pid: states)
    guard, _ = keys_process
    os.kill(guard._process.pid, signal.SIGSTOP)
    until(lambda: not guard.alive, "the terminal reads the keys itself")


def test_a_terminal_that_is_busy_does_not_end_the_process_of_the_keys(
    keys_process: Guarded,
) -> None:
    """Its answer had been read, and waited for the interpreter beside the thread that judges."""
    guard, _ = keys_process
    answers: list[float] = []

    class Late(threading.Event):
        def set(self) -> None:
            ctypes.PyDLL(None).usleep(int(1.2e6 * stopper.ASLEEP_S))  # no other thread runs
            super().set()
            answers.append(time.monotonic())

    guard._here = Late()
    until(lambda: len(answers) > 2 or not guard.alive, "it was asked three times")
    assert guard.alive


def test_the_end_of_the_process_of_the_keys_is_told_since_a_stop_may_have_gone_with_it(
    keys_process: Guarded,
) -> None:
    guard, told = keys_process
    told.clear()
    guard._process.kill()
    until(lambda: not guard.alive, "the terminal reads the keys itself")
    until(lambda: "not stopped" in told, "loudly")


def test_a_word_that_cannot_be_read_ends_the_process_of_the_keys_rather_than_all_words(
    keys_process: Guarded, monkeypatch: pytest.MonkeyPatch
) -> None:
    guard, told = keys_process
    told.clear()
    monkeypatch.setattr(stopper, "HERE", "away")  # so "here" is no state that there is
    until(lambda: not guard.alive, "the terminal reads the keys itself")
    until(lambda: "not stopped" in told, "loudly")


def test_a_stop_is_asked_by_the_link_where_the_page_breaks_after_it_was_pressed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Broken:
        def ask(self) -> int:
            return 0

        def taken(self, asked: int, timeout: float) -> int | None:
            raise ValueError("gone")

    told: list[str] = []
    links = stop_process.Links()
    monkeypatch.setattr(links, "page", Broken)
    stops = stop_process.Stops(links, lambda state, *_: told.append(state))
    for _ in range(stop_process.STOPPERS + 1):  # one more than there are threads to lose
        told.clear()
        stops.press()
        until(lambda: "asked" in told, "each is taken")


def test_no_link_is_given_up_for_an_error_that_nobody_thought_of(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Panic(BaseException):
        """Like a panic of Rust, which is no `Exception`."""

    calls: list[str] = []

    def fails(name: str, *_: object, **__: object) -> None:
        calls.append(name)
        raise Panic

    monkeypatch.setattr(stop_process, "connect", fails)
    monkeypatch.setattr(stop_process, "RETRY_S", 0.01)
    links = stop_process.Links()
    links.want("imi", here=False)
    until(lambda: len(calls) > 2, "tried again and again")
    links.want("", here=False)


def test_a_process_of_the_keys_that_gets_no_processor_is_waited_for(
    keys_process: Guarded, monkeypatch: pytest.MonkeyPatch
) -> None:
    guard, told = keys_process
    looks: list[int] = []
    monkeypatch.setattr(stopper, "_states", lambda pid: looks.append(pid) or {"R", "S"})
    os.kill(guard._process.pid, signal.SIGSTOP)
    until(lambda: len(looks) > 2 * stopper.ASLEEP_S / stopper.LOOK_S, "it was looked at for long")
    assert guard.alive
    os.kill(guard._process.pid, signal.SIGCONT)
    told.clear()
    guard.stop()
    until(lambda: "asked" in told, "it answers again")
    assert guard.alive
