"""Two hosts that load: the first start after a load starts that program, and no other."""

from __future__ import annotations

import threading

import pytest

from zendsp.errors import CompileFailed, Refused
from zendsp.link import Target, connect
from zendsp_target.serving.first_start import MOST, FirstStart

EMPTY = '#include "isr.h"\nvoid UserInit(void) {}\nvoid UserISR_INT2(void) {}\n'


def test_a_host_does_not_start_the_program_of_another_in_place_of_its_own(process: Target) -> None:
    process.download("pd.c")
    with connect(process.name) as other:
        theirs = other.download({"theirs.c": EMPTY})
        with pytest.raises(Refused, match="has loaded a program since you loaded yours") as refused:
            process.start()
        assert other.link.author in str(refused.value)
        assert process.status().state == "loaded"
        process.start()  # it knows now
        assert process.status().program == theirs.key
        process.pause()


def test_once_started_a_host_may_start_what_others_load(process: Target) -> None:
    process.download("pd.c")
    process.start()
    process.pause()
    with connect(process.name) as other:
        other.download({"theirs.c": EMPTY})
        process.start()
        process.pause()


def test_a_load_that_fails_takes_nothing_from_others(process: Target) -> None:
    mine = process.download("pd.c")
    with connect(process.name) as other:
        with pytest.raises(CompileFailed):
            other.download({"theirs.c": "nonsense"})
        with pytest.raises(Refused):
            other.load("no such key")
    process.start()
    assert process.status().program == mine.key
    process.pause()


def test_a_start_that_waits_for_the_load_of_another_is_refused() -> None:
    """The runtime loads for 0.1 s; a start in that time is carried out after it."""
    first = FirstStart()
    first.loaded("me")
    first.loading("other")
    with pytest.raises(Refused, match="other has loaded"):
        first.check("me")
    first.check("me")


def test_of_many_hosts_the_newest_are_remembered() -> None:
    first = FirstStart()
    hosts = [f"host {k}" for k in range(2 * MOST)]
    threads = [threading.Thread(target=first.loaded, args=(host,)) for host in hosts[:MOST]]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for host in hosts[MOST:]:
        first.loaded(host)
    first.loading("other")
    first.check(hosts[0])  # forgotten
    with pytest.raises(Refused):
        first.check(hosts[-1])
