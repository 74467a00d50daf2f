"""A transfer gives the same rows from shared memory on this computer and over the link from
another.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest
from waiting import until

import zendsp
from zendsp.errors import AcquisitionError, Refused, RunnerDied
from zendsp.link import Target
from zendsp.link.transfer import open_held
from zendsp_protocol import messages as m


def refuse(*_: Any) -> None:
    raise AssertionError("this road was not to be taken")


@pytest.fixture
def far(fast: Target) -> Iterator[Target]:
    """A host that connects by address, and so transfers over the link."""
    with zendsp.connect(fast.name, connect=fast.link.endpoints) as far:
        yield far


@pytest.mark.parametrize("continuous", [False, True])
def test_rows_are_the_same_from_shared_memory_and_over_the_link(
    fast: Target, far: Target, monkeypatch: pytest.MonkeyPatch, continuous: bool
) -> None:
    fast.download("pd.c")
    fast.acquire_configure(["tick", "q", "tau"], seconds=1.0, continuous=continuous)
    fast.acquire_start()
    fast.run_for(3.7)  # a ring of a second goes round more than three times
    if continuous:
        fast.acquire_stop()
    assert not far.link.own  # it has no other road
    over_the_link = far.acquire_load()
    monkeypatch.setattr(fast.recorder, "_load_streamed", refuse)
    told: list[float] = []
    near = fast.acquire_load(progress=told.append)
    assert (
        np.array_equal(near.data, over_the_link.data)
        and near.data.shape[1] == 5
        and told[-1] == 1.0
    )
    last = 3699 if continuous else 999
    assert np.array_equal(near["tick"], np.arange(last - 999, last + 1))


def test_rows_that_the_ring_no_longer_holds_are_refused_on_either_road(
    fast: Target, far: Target
) -> None:
    fast.download("pd.c")
    fast.acquire_configure(["tick"], seconds=0.5, continuous=True)
    fast.acquire_start()
    fast.run_for(2.0)
    for host in (fast, far):
        for first, count in ((0, 10), (1990, 20), (1000, 900)):
            with pytest.raises(AcquisitionError, match=r"are not held; the recorder has 1500…2000"):
                host.load_rows(first, count, 1)


def test_rows_that_are_overwritten_while_they_are_read_are_refused(
    fast: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    fast.download("pd.c")
    fast.acquire_configure(["tick"], seconds=0.5, continuous=True)
    fast.acquire_start()
    fast.run_for(0.5)
    monkeypatch.setattr(fast.recorder, "_load_streamed", refuse)
    with pytest.raises(AcquisitionError, match="are not held"):
        fast.load_rows(0, 500, 1, progress=lambda _: fast.run_for(0.1))
    with pytest.raises(AcquisitionError, match="configured again"):
        fast.load_rows(200, 300, 1, progress=lambda _: fast.acquire_configure(["tick"], 0.5))


def test_a_file_that_is_not_the_recorders_is_not_read(fast: Target) -> None:
    fast.download("pd.c")
    fast.acquire_configure(["tick"], seconds=0.5)
    held: m.Held = fast.request("acquire_held")
    file = open_held(held)
    assert file >= 0
    with pytest.raises(OSError):
        os.write(file, b"x")
    os.close(file)
    for wrong in (
        {"kernel": "another"}, {"inode": held.inode + 1}, {"device": 0}, {"path": "/dev/null"},
        {"path": ""},
    ):
        assert open_held(msgspec.structs.replace(held, **wrong)) == -1


LIST = """#include "isr.h"
static double gain = 1.0, list[3], seen;
void UserInit(void) {
    PARAMETER(gain, 1.0, "", NO_MIN, NO_MAX, ""); PARAMETER_ARRAY(list, "", -9.0, 9.0, ""); SIGNAL(seen, "", "");
}
void UserISR_INT2(void) { seen = gain + 100.0 * list[1]; }
void UserBackground(void) {}
"""  # noqa: E501


def test_a_recording_holds_the_parameters_of_its_last_sample_not_those_of_its_loading(
    fast: Target,
) -> None:
    fast.download({"list.c": LIST})
    fast.update(gain=2.0, list=[0.0, 3.0, 0.0])
    fast.acquire_configure(["seen", "gain"], seconds=0.1)
    fast.acquire_start()
    fast.run_for(0.1)
    held = fast.acquire_load()
    fast.start()
    for k in range(3):  # after the last sample, before the transfer
        fast.update(**{"gain": 7.0 + k, "list[1]": 5.0 + k})
        fast.update(list=[1.0, 2.0, float(k)])
    later = fast.acquire_load()
    assert list(later["seen"]) == list(held["seen"]) == [302.0] * 100
    assert later.parameters == held.parameters == {"gain": 2.0, "list": [0.0, 3.0, 0.0]}
    assert [(c.name, c.new) for c in later.log] == [(c.name, c.new) for c in held.log]
    assert fast.parameters().values == {"gain": 9.0, "list": [1.0, 2.0, 2.0]}


def test_rows_keep_the_program_that_made_them_when_another_is_loaded(fast: Target) -> None:
    fast.download("pd.c")
    fast.update(Kp1=1234.0)
    whole = fast.acquire(["q"], 0.1, start=True)
    fast.update(Kp1=1500.0)
    fast.download("joint_pd.c")
    later = fast.acquire_load()
    assert later.sources == whole.sources and later.source_hash == whole.source_hash
    assert later.parameters == whole.parameters and later.parameters["Kp1"] == 1234.0
    assert later.log == whole.log and later.extra == whole.extra
    fast.unload()
    assert fast.acquire_load().sources == whole.sources
    fast.download("joint_pd.c")
    sources = fast.acquire(["q"], 0.1, start=True).sources
    assert set(sources) == {"joint_pd.c", "motion.h", "blocked.h", "reversal.h"}


def test_rows_of_a_program_that_crashed_keep_it_when_another_is_loaded(fast: Target) -> None:
    crashes = (
        '#include "isr.h"\nvoid UserInit(void) {}\n'
        "void UserISR_INT2(void) { if (SAMPLE_TICK == 500) *(volatile int *)0 = 1; }\n"
    )
    fast.download({"crashes.c": crashes})
    with pytest.raises(RunnerDied):
        fast.acquire(["t"], 1.0, start=True)
    fast.download("pd.c")
    rows = fast.acquire_load()
    assert list(rows.sources) == ["crashes.c"] and len(rows) == 500 and "Kp1" not in rows.parameters


@pytest.mark.parametrize("fate", ["for (;;) ;", "__builtin_trap();"])
def test_the_log_of_a_recording_has_the_change_that_crashed_the_program(
    fast: Target, fate: str
) -> None:
    fast.download({"crash.c": f"""
#include "isr.h"
static double go;
void UserInit(void) {{ PARAMETER(go, 0.0, "", 0.0, 1.0, "ends it"); }}
void UserISR_INT2(void) {{ if (go > 0.0) {{ {fate} }} }}
"""})
    fast.acquire_configure(["t"], seconds=60.0)
    fast.acquire_start()
    fast.start()
    until(lambda: fast.acquire_status().count > 10, "rows")
    fast["go"] = 1.0
    until(lambda: fast.status().state == "crashed", "the crash")
    recording = fast.acquire_load()
    (change,) = recording.log
    assert (change.name, change.new) == ("go", 1.0)
    assert change.tick > recording.start_tick + len(recording) - 1, "its sample left no row"
    assert recording.parameters["go"] == 0.0, "as it was in the last row"


def test_rows_of_two_recordings_are_never_mixed(
    fast: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    fast.download("pd.c")
    fast.acquire(["q"], 0.5, start=True)
    load = fast.recorder.load_rows

    def slowly(*given: Any) -> Any:
        rows = load(*given)
        fast.acquire_start()  # somebody else's script, say: its shot has as many rows
        fast.run_for(0.6)
        return rows

    monkeypatch.setattr(fast.recorder, "load_rows", slowly)
    with pytest.raises(Refused, match="this host itself began another recording"):
        fast.acquire_load()
    monkeypatch.undo()
    assert len(fast.acquire_load()) == 500
