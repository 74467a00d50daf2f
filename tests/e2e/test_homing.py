"""A machine that has to be homed, and one whose home switch is never found."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner
from waiting import until

import zendsp
import zendsp_isr
from zendsp.cli.entry import cli
from zendsp.errors import Refused
from zendsp.experiment import Lab, run_experiment
from zendsp.link import Target

CODE = {
    "p.c": '#include "isr.h"\nvoid UserInit(void) {}\nvoid UserISR_INT2(void) {}\n'
    "void UserBackground(void) {}\n"
}
MACHINE = """
#include <stdlib.h>
#include <string.h>
#include "machine.h"
static int lost; /* the home switch is */
static long samples;
static int open_(void **h, const char *config, double dt, machine_info *i, char *e, size_t n) {
    (void)dt, (void)e, (void)n;
    *h = &samples;
    lost = strstr(config, "lost") != NULL;
    strcpy(i->name, "axis");
    i->simulated = i->joints = i->needs_homing = 1;
    i->stop_input = -1;
    machine_joint *j = &i->joint[0];
    strcpy(j->name, "joint 1"), strcpy(j->unit, "rad"), strcpy(j->command, "torque");
    j->counts_per_unit = j->mv_per_torque = j->mv_per_speed = 1000.0;
    j->command_max = 10000.0, j->position_max = 1.0, j->position_min = -1.0;
    j->speed_max = j->torque_max = 10.0;
    return 0;
}
static void read_(void *h, machine_sensors *s) { (void)h, s->enc[0] = 0; }
static void write_(void *h, const machine_actuators *u) { (void)h, (void)u; }
static void step(void *h, double dt) { (void)h, (void)dt, samples++; }
static void safe(void *h) { (void)h; }
static int home(void *h, const machine_sensors *s, machine_actuators *u) {
    (void)h, (void)s, u->mode = MACHINE_VELOCITY, u->aout[0] = 10.0;
    return lost || samples < 100 ? MACHINE_HOME_BUSY : MACHINE_HOME_DONE;
}
const machine_ops zendsp_machine = {.abi = MACHINE_ABI, .open = open_, .read = read_,
    .write = write_, .step = step, .safe = safe, .home = home};
"""


def main_says(command: str, target: str) -> str:
    """What ``zendsp COMMAND`` prints of a target."""
    done = CliRunner().invoke(cli, [command, "-t", target])
    assert done.exit_code == 0, done.output
    return done.stdout


def _pause_while_homing(target: Target) -> threading.Thread:
    """A thread that pauses a homing as soon as the target tells it."""

    def pause() -> None:
        until(lambda: target.status().homing, "it homes")
        target.pause()

    thread = threading.Thread(target=pause)
    thread.start()
    return thread


@pytest.fixture
def machine(tmp_path: Path) -> str:
    file = tmp_path / "axis.c"
    file.write_text(MACHINE)
    return str(file)


def test_nothing_starts_before_the_position_is_known(machine: str) -> None:
    with zendsp.local(machine) as target:
        target.download(CODE)
        words = "starting is refused: homed: the position is unknown: .*each load asks for it anew"
        with pytest.raises(Refused, match=words):
            target.start()
        assert target.status().state == "loaded"
        target.power_on()
        assert target.home_and_wait() == "homed"
        target.enable()
        target.start()
        assert target.status().drive == "running"


def test_homing_without_end_ends_with_the_time_it_was_given_or_with_a_pause(machine: str) -> None:
    with zendsp.local(machine, options=["--machine-option", "lost=1"]) as target:
        target.download(CODE)
        with pytest.raises(Refused, match=r"not done after 0\.5 s and is ended"):
            target.home_and_wait(0.5)
        assert target.status().state != "running" and not target.status().homed
        target.home()
        seen = target.status()
        assert seen.homing and seen.doing == "homing" and "axis: homing, drives" in repr(seen)
        assert main_says("drive", target.name).startswith("homing, velocity mode")
        assert "state      homing, tick" in main_says("info", target.name)
        listed = CliRunner().invoke(cli, ["ls"]).stdout.splitlines()
        assert [line.split()[2] for line in listed if line.startswith(target.name)] == ["homing"]
        target.pause()
        assert not target.status().homing
        pause = _pause_while_homing(target)
        with pytest.raises(Refused, match="homing ended: by a pause, or another load"):
            target.home_and_wait()
        pause.join()


def test_a_homing_that_was_cut_short_is_not_told_as_done(machine: str) -> None:
    """Neither of a machine that was homed before, nor of one whose positions are always known."""
    for name, known in ((machine, False), ("imi_planar", True)):
        with zendsp.local(name, options=["--machine-option", "q1=1.5"]) as target:
            target.download(CODE)
            if not known:
                assert target.home_and_wait() == "homed" and target.status().homings == 1
                with zendsp.local(name, options=["--machine-option", "lost=1"]) as other:
                    other.download(CODE)
                    with pytest.raises(Refused):
                        other.home_and_wait(0.2)
                    assert not other.status().homed
                continue
            pause = _pause_while_homing(target)
            with pytest.raises(Refused, match="homing ended: by a pause"):
                target.home_and_wait()
            pause.join()
            assert target.status().homed, "its encoders are absolute"


@pytest.fixture
def arm_to_home(tmp_path: Path) -> str:
    """The planar arm, with encoders that are not absolute."""
    machines = Path(zendsp_isr.__file__).parent / "machines"
    for header in machines.glob("*.h"):
        shutil.copy(header, tmp_path)
    text = (machines / "imi_planar.c").read_text()
    assert text.count("    info->stop_input = 0;\n") == 1
    text = text.replace("    info->stop_input = 0;\n", "    info->needs_homing = 1;\n")
    text = text.replace("info->stop_level = 1;", "info->stop_input = -1;")
    (tmp_path / "homed.c").write_text(text)
    return str(tmp_path / "homed.c")


@pytest.mark.long("drives are homed by others; lost: by an experiment")
def test_an_experiment_homes_a_machine_that_has_to_be(arm_to_home: str, tmp_path: Path) -> None:
    said: list[str] = []
    with zendsp.local(arm_to_home, clock="fast", options=["--ideal"]) as target:
        lab = Lab(tmp_path / "kept", target, said.append)
        result = run_experiment("friction", lab)
        assert abs(result.values["coulomb1"].value - 8.45) < 1.0
        assert "where_it_stands: homing the machine" in said
        assert not target.drive_status().explicit and target.status().state == "empty"


def test_an_experiment_enables_the_drives_again_and_is_refused_before_where_they_are_off(
    arm_to_home: str, tmp_path: Path
) -> None:
    with zendsp.local(arm_to_home, clock="fast", options=["--ideal", "--managed"]) as target:
        lab = Lab(tmp_path / "kept", target)
        for _ in range(2):
            with pytest.raises(Refused, match="friction moves the machine, and its drives are off"):
                run_experiment("friction", lab)
            assert not (tmp_path / "kept" / "friction").exists()
            target.download("pd.c")
        target.power_on()
        target.home_and_wait()
        target.enable()
        run_experiment("friction", lab)
        assert target.drive_status().commander == target.link.author
        assert target.status().drive == "ready", "loading what was there before switches them off"
