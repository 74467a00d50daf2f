"""The safe sequence of the drives, on a real target process, by the API."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from hardware import driver
from msgspec.structs import replace
from waiting import until

from zendsp.errors import Refused
from zendsp.link import Target, connect, local
from zendsp_protocol.messages import Limits, Status, Timing
from zendsp_target.api import RuntimeApi
from zendsp_target.serving.drives import Drives

_NONE = np.zeros(0, dtype=np.int64)
_STATUS = Status(
    "empty",
    0,
    0.0,
    1000.0,
    "fast",
    "",
    "m",
    1,
    "",
    Timing(0, 0, 0, 0.0, 0, 0.0, 0, _NONE, _NONE, np.zeros(1)),
    "off",
    None,
    "",
)


def test_a_script_need_not_know_the_sequence(target: Target) -> None:
    target.start()
    assert target.status().drive == "running" and not target.drive_status().explicit
    until(lambda: target.status().io["aout"][0] != 0.0, "the drives are on")
    target.pause()


def test_off_ready_homed_enabled_running_and_back(target: Target) -> None:
    states = [target.power_off() and target.drive_status().state]
    target.power_on()
    states.append(target.drive_status().state)  # absolute encoders: ready and homed at once
    target.home_and_wait()
    target.enable()
    states.append(target.drive_status().state)
    target.start()
    states.append(target.drive_status().state)
    target.disable()
    target.pause()
    states.append(target.drive_status().state)
    assert states == ["off", "homed", "enabled", "running", "homed"]


CRASH = """#include "isr.h"
static int32_t go;
void UserInit(void) { PARAMETER(go, 0, "", 0, 1, "crash"); }
void UserISR_INT2(void) { if (go) __builtin_trap(); }
void UserBackground(void) {}
"""


def test_after_a_crash_nothing_is_enabled(target: Target, tmp_path: Path) -> None:
    (tmp_path / "crash.c").write_text(CRASH)
    target.download(tmp_path / "crash.c")
    target.power_on()
    target.home_and_wait()
    target.enable()
    target.start()
    target["go"] = 1
    until(lambda: target.status().crash != "", "it crashed")
    drives = target.drive_status()
    assert (drives.state, drives.mode) == ("ready", "off")
    assert not {"enabled", "running"} & {target.status().drive}
    target.download("pd.c")


def test_enabling_moves_nothing_though_a_program_went_on_beside_drives_that_were_off(
    target: Target,
) -> None:
    for off in (target.disable, target.power_off):
        target.drive_auto()
        target.start()
        off()
        target.power_on()
        for on, word in ((target.enable, "enabling"), (target.drive_auto, "automatic")):
            with pytest.raises(Refused, match=f"{word}.* is refused: the program runs .*pause it"):
                on()
        assert target.drive_status().mode == "off"
        target.pause()
    target.enable()
    assert target.drive_status().state == "enabled"


def test_power_is_not_switched_on_beneath_a_program_that_moves_the_machine(target: Target) -> None:
    """The drives of the automatic mode went off, and an arm fell."""
    target.start()
    until(lambda: target.status().io["aout"][0] != 0.0, "the drives are on")
    with pytest.raises(Refused, match=r"power on is refused: the program runs .*pause it first"):
        target.power_on()
    assert target.drive_status().state == "running" and not target.drive_status().explicit
    target.pause()
    target.power_on()
    assert target.drive_status().state == "homed"


def test_the_drives_start_softly(target: Target) -> None:
    target.power_on()
    target.enable()
    rec = target.acquire(["aout", "cmd"], seconds=0.3, start=True)
    # an output acts one sample after it was computed, times the gain
    k = int(np.argmax(np.abs(rec["cmd"][:, 0]) > 50.0))
    gain = rec["aout"][k + 1 :, 0] / rec["cmd"][k:-1, 0]
    rising = (k + 1 + np.arange(len(gain))) < 95  # of 100 samples
    assert (gain[rising] < 0.99).all() and (np.diff(gain[rising]) > 0.0).all()
    assert gain[110:] == pytest.approx(1.0)


def test_each_refusal_names_what_fails(process: Target) -> None:
    process.unload()
    process.power_on()
    with pytest.raises(
        Refused, match=r"enabling is refused: program: no code is loaded .*; homed, .*: known"
    ):
        process.enable()
    process.download("pd.c")
    process.power_off()
    with pytest.raises(Refused, match="enabling is refused: power: switch the drives' power on"):
        process.enable()
    process.power_on()
    with pytest.raises(Refused, match="starting is refused: enabled"):
        process.start()
    process.stop()
    until(lambda: process.status().trip is not None, "latched at the next sample")
    with pytest.raises(Refused, match="enabling is refused: trip: STOP"):
        process.enable()
    process.acknowledge()
    with pytest.raises(Refused, match="mode 'fast': expected one of off, torque, velocity, auto"):
        process.enable("fast")
    with pytest.raises(Refused, match="drive mode off: expected torque or velocity"):
        process.enable("off")
    process.drive_auto()
    process.release_command()


def test_a_refused_enable_changes_nothing(target: Target) -> None:
    target.start()
    target.stop()
    until(lambda: target.status().trip is not None, "latched at the next sample")
    with pytest.raises(Refused, match="enabling is refused: trip: STOP"):
        target.enable()
    assert not target.drive_status().explicit, "still automatic"
    target.acknowledge()
    target.start()
    assert target.drive_status().state == "running", "as after any STOP in automatic"


def test_where_every_condition_is_met_enabling_is_not_refused(target: Target) -> None:
    target.start()
    target.stop()
    until(lambda: target.status().trip is not None, "latched at the next sample")
    target.acknowledge()
    status = target.drive_status()
    assert not status.explicit and all(c.met for c in status.conditions)
    target.enable()
    status = target.drive_status()
    assert status.explicit and status.state == "enabled"


def test_enabling_wants_finite_limits(target: Target) -> None:
    status = replace(_STATUS, state="loaded", io={"enc": np.zeros(2)})
    endless = Limits((-1.0,), (1.0,), (2.0,), (float("inf"),), (5.0,), torque_clamp=False)
    for limits, met in ((endless, False), (replace(endless, torque_max=(3.0,)), True)):
        runtime = SimpleNamespace(limits=lambda limits=limits: limits, status=lambda: status)
        conditions = {c.name: c.met for c in Drives(cast(RuntimeApi, runtime)).conditions(status)}
        assert conditions["limits"] is met
    with pytest.raises(Refused, match="finite"):
        target.set_limits(torque_max=[float("inf")] * 2)


def test_enabling_beside_a_sensor_that_reports_a_fault_is_refused(tmp_path: Path) -> None:
    """All conditions had been shown as met, and the first sample tripped."""
    source, broken = tmp_path / "driver.c", tmp_path / "broken"
    read = f's->enc[0] = 5; s->fault = access("{broken}", F_OK) == 0;'
    source.write_text(driver("", read=read))
    with local(str(source), clock="real", options=["--no-realtime"]) as target:
        target.download("pd.c")
        target.power_on()
        broken.touch()
        until(lambda: not _met(target, "sensors"), "the fault is read while nothing runs")
        with pytest.raises(Refused, match="fault of joint 1: mend it"):
            target.enable()
        broken.unlink()
        until(lambda: _met(target, "sensors"), "the fault is gone")
        target.enable()


def _met(target: Target, name: str) -> bool:
    (found,) = (c for c in target.drive_status().conditions if c.name == name)
    return found.met


def test_an_emergency_stop_input_that_is_not_yet_read_is_not_reported_as_released() -> None:
    """The loop reads its input, so that without a program a pressed button had looked released."""
    none = Limits((), (), (), (), (), torque_clamp=False)
    runtime = SimpleNamespace(limits=lambda: none, status=lambda: _STATUS)
    conditions = Drives(cast(RuntimeApi, runtime)).conditions(_STATUS)
    (stop,) = (c for c in conditions if c.name == "stop input")
    assert not stop.met and stop.advice == "known once a program is loaded"


def test_stop_acts_from_any_host_and_nothing_moves_before_enable(target: Target) -> None:
    target.power_on()
    target.enable()
    target.start()
    with connect(target.name) as other:
        other.stop()
    until(lambda: target.drive_status().state == "stopped", "stopped")
    with pytest.raises(Refused):
        target.start()
    target.acknowledge()
    assert target.drive_status().state == "homed"
    with pytest.raises(Refused, match="enabled"):
        target.start()
    target.enable()
    target.start()
    assert target.drive_status().state == "running"


def test_with_nothing_latched_acknowledge_says_so_and_a_program_goes_on(target: Target) -> None:
    target.start()
    assert "nothing to acknowledge" in target.acknowledge()
    assert "nothing to acknowledge" in _cli(target, "acknowledge").stderr
    assert target.status().state == "running"
    target.stop()
    assert target.acknowledge().startswith("acknowledged; start the program")
    target.pause()
    target.power_on()
    target.enable()
    target.acknowledge()
    assert target.drive_status().state == "enabled", "the drives stay as they are, too"


def test_a_trip_that_came_after_what_was_seen_is_not_acknowledged(target: Target) -> None:
    target.start()
    seen = target.stop().trip
    assert seen is not None
    with connect(target.name) as other:
        other.stop()
    with pytest.raises(Refused, match="another STOP or trip came after"):
        target.acknowledge(seen)
    assert target.status().trip is not None
    target.acknowledge(target.status().trip)
    one = target.stop().trip
    assert target.acknowledge(one).startswith("acknowledged")
    again = target.stop().trip
    assert one is not None and again is not None and one.tick == again.tick, "it stands still"
    with pytest.raises(Refused, match="another STOP or trip came after"):
        target.acknowledge(one)
    wrong = _cli(target, "acknowledge", "--sample", f"{seen.tick}")
    assert wrong.returncode == 2 and f"since sample {again.tick}" in wrong.stderr
    assert target.status().trip is not None
    right = _cli(target, "acknowledge", "--sample", f"{again.tick}")
    assert "(it was: STOP was requested" in right.stderr and target.status().trip is None


def test_managed_targets_enforce_the_sequence() -> None:
    with local("imi_planar", clock="fast", options=["--speed", "20", "--managed"]) as target:
        target.download("pd.c")
        assert target.drive_status().state == "off"
        with pytest.raises(Refused, match="starting is refused: power"):
            target.start()
        with pytest.raises(Refused, match="--managed"):
            target.drive_auto()
        target.power_on()
        target.enable()
        target.start()
        assert target.status().drive == "running"


def _cli(target: Target, *words: str) -> subprocess.CompletedProcess[str]:
    call = [
        sys.executable, "-c", "from zendsp.cli import main; main()", "drive", *words, "--target",
        target.name,
    ]
    return subprocess.run(call, capture_output=True, text=True, timeout=100, check=False)


def test_the_command_line_goes_through_the_sequence(target: Target) -> None:
    refused = _cli(target, "off"), _cli(target, "enable")
    assert refused[0].returncode == 0 and refused[1].returncode == 2
    assert "power: switch the drives' power on" in refused[1].stderr
    for action in ("on", "home", "enable"):
        assert _cli(target, action).returncode == 0
    assert target.drive_status().state == "enabled" and target.drive_status().commander == ""
    target.take_command()
    assert "exclusive right" in _cli(target, "off").stderr
    taken = _cli(target, "take", "--force")
    assert taken.returncode == 0 and "taken, and free again" in taken.stderr
    assert "commanded by nobody" in taken.stdout
    assert target.drive_status().commander == "", "freed"


def test_an_emergency_stop_that_is_still_pressed_is_not_acknowledged(target: Target) -> None:
    """Neither that which tripped, nor one that was pressed after another trip."""
    pressed = "STOP input of the machine is active: release the emergency stop"
    for first in (lambda: target.set_inputs(1), target.stop):
        target.start()
        first()
        until(lambda: target.status().trip is not None, "latched at the next sample")
        target.set_inputs(1)
        for _ in range(2):
            with pytest.raises(Refused, match=f"acknowledging is refused: the {pressed}"):
                target.acknowledge()
        assert target.status().trip is not None
        said = _cli(target, "acknowledge")
        assert said.returncode != 0 and pressed in said.stderr
        target.set_inputs(0)
        assert target.acknowledge().startswith("acknowledged")


def test_nothing_starts_while_the_emergency_stop_is_pressed(target: Target) -> None:
    target.set_inputs(1)
    pressed = "stop input: the STOP input of the machine is active: release the emergency stop"
    for what, word in ((target.start, "starting"), (target.enable, "enabling")):
        with pytest.raises(Refused, match=f"{word} is refused: {pressed}"):
            what()
    with pytest.raises(Refused, match=f"homing is refused: {pressed}"):
        target.home_and_wait()
    status = target.status()
    assert status.trip is None and status.tick == 0, "and nothing has tripped"
    assert [c.name for c in target.drive_status().conditions if not c.met] == ["stop input"]
    target.set_inputs(0)
    target.start()


def test_off_is_told_when_the_drives_are_off(target: Target) -> None:
    for switch in (target.disable, target.power_off):
        target.power_on()
        target.enable()
        target.start()
        until(lambda: target.status().io["aout"][0] != 0.0, "it commands")  # type: ignore[index]
        what, rest = switch().split("; ")
        assert what in ("disabled", "power off")
        assert rest == "the program runs on and moves nothing: pause it before you enable again"
        assert target.status().drive_mode == "off"
        target.pause()
    target.power_on()
    target.enable()
    target.start()
    target.set_ramp(50.0)
    assert target.disable() == "disabled; the soft stop of 50 s goes on"
    target.stop()
    assert "until the trip is acknowledged, the drives hold at zero speed" in target.power_off()
    target.set_ramp(0.0)
