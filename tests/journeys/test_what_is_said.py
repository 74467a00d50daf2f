"""What zendsp says is what is: a program that trips or crashes at once, values of one that is gone,
names that are mistyped.
"""

from __future__ import annotations

import json
import os
import signal
import time

import pytest
from journey import PATIENCE_S, Installed, until

HEAD = '#include "isr.h"\nstatic double a = 1.0;\nstatic bool on;\nstatic double list[3];\n'
INIT = """void UserInit(void) {
    PARAMETER(a, 1.0, "V", -10.0, 10.0, ""); PARAMETER(on, 0, "", 0, 1, ""); PARAMETER(list, 0, "", NO_MIN, NO_MAX, "");
}
void UserBackground(void) {}
"""  # noqa: E501
TRIPS = HEAD + INIT + "void UserISR_INT2(void) { a = 2.0; WRITE_TORQUE(0, 0.0 / (a - 2.0)); }\n"
CRASHES = HEAD + INIT + "void UserISR_INT2(void) { *(volatile int *)8 = 1; }\n"
WORDS = pytest.mark.long("tests/whole/test_usage.py has the commonest; lost: these words")
AFTER_TRIP_S = 1.0  # what a recorder still records after a trip
RUNS = HEAD + INIT + "void UserISR_INT2(void) {}\n"


@pytest.fixture
def user(installed: Installed) -> Installed:
    """A user with a target, and programs that trip, crash and run."""
    for name, text in (("trips.c", TRIPS), ("crashes.c", CRASHES), ("runs.c", RUNS)):
        installed.write(name, text)
    installed.target("imi")
    return installed


def test_run_says_that_the_program_tripped_at_its_first_sample(user: Installed) -> None:
    said = user.run("run", "trips.c")
    assert said.returncode == 1 and "running" not in said.stdout, said
    assert (
        "tripped" in said.stderr
        and "sample" in said.stderr
        and "zendsp drive acknowledge" in said.stderr
    )
    other = user.run("get", "a", "--json")  # whatever talks to the target says so; JSON stays clean
    assert json.loads(other.stdout)["ended"] and other.returncode == 0
    assert other.stderr.count("tripped") == 1 and len(other.stderr.splitlines()) == 1
    timed = user.run("run", "--seconds", "0.1")
    assert timed.returncode == 2 and timed.stderr.count("zendsp drive acknowledge") == 1
    assert len(timed.stderr.splitlines()) == 1, timed  # what is latched is said once
    assert user.run("drive", "acknowledge").stderr.startswith("acknowledged")
    again = user.run("run", "--seconds", "0.1")
    assert again.returncode == 1 and "tripped" in again.stderr


def test_run_says_that_the_program_crashed_and_reading_it_says_so(user: Installed) -> None:
    said = user.run("run", "crashes.c")
    assert said.returncode == 1 and "running" not in said.stdout, said
    assert "crashed" in said.stderr and "SIGSEGV" in said.stderr and "zendsp run" in said.stderr
    read = user.run("get", "a")
    assert "a = 1" in read.stdout and "crashed" in read.stderr
    script = user.script(
        "import warnings, zendsp\n"
        "with zendsp.connect('imi') as t, warnings.catch_warnings(record=True) as told:\n"
        "    warnings.simplefilter('always')\n"
        "    assert t['a'] == 1.0 and 'crashed' in str(told[0].message), told\n"
        "    assert 'crashed' in t.read(['a']).ended and 'crashed' in t.read(['a']).ended\n"
        "    t.download('runs.c'); t.start()\n"
        "    assert t.read(['a']).ended == '' and t.read(['a']).ended == ''\n"
        "    assert t['a'] == 1.0 and len(told) == 1\n"
        "    t.stop(); t.wait()\n"
        "    assert 'STOP' in t.read(['a']).ended\n"
    )
    assert script.returncode == 0, script.stderr


def test_run_says_that_a_compensation_acts(user: Installed) -> None:
    blank = RUNS.replace("a, 1.0", "comp_share, 1.0").replace(" a ", " comp_share ")
    user.write("blank.c", blank)
    acts = blank.replace("bool on", "bool comp_on").replace("PARAMETER(on", "PARAMETER(comp_on")
    user.write("with.c", acts)
    said = user.run("run", "with.c", "--set", "comp_share=0.5")
    assert said.returncode == 0 and "times comp_share = 0.5 (" in said.stderr, said
    assert "comp_share" not in user.run("run", "runs.c").stderr
    assert "comp_share" not in user.run("run", "blank.c").stderr, "nothing can be compensated"


def test_start_says_that_the_program_ended_in_its_first_samples(user: Installed) -> None:
    script = user.script(
        "import zendsp\n"
        "from zendsp.errors import RunnerDied, Tripped\n"
        "from zendsp.matdsp import *\n"
        "def raises(what, call, *words):\n"
        "    try: call()\n"
        "    except what as e: assert all(w in str(e) for w in words), e\n"
        "    else: raise SystemExit(f'{call} returned')\n"
        "with zendsp.connect('imi') as t:\n"
        "    t.download('trips.c')\n"
        "    raises(Tripped, t.start, 'started', 'sample 0', 'acknowledge()')\n"
        "    t.acknowledge()\n"
        "    raises(Tripped, lambda: t.start(5), 'started', 'acknowledge()')\n"
        "    t.acknowledge(); t.download('crashes.c')\n"
        "    raises(RunnerDied, t.start, 'crashed', 'SIGSEGV')\n"
        "    t.download('runs.c'); t.start(2); assert t.wait().tick == 2\n"
        "    t.start(); assert t.status().state == 'running'\n"
        "MatDSPconnect('imi'); MatDSPdownload('trips.c')\n"
        "raises(Tripped, MatDSPstart, 'started', 'acknowledge()')\n"
        "MatDSPclose()\n"
    )
    assert script.returncode == 0, script.stderr


def test_load_loads_without_starting(user: Installed) -> None:
    said = user.run("load", "pd.c")
    assert said.returncode == 0, said.stderr
    state = json.loads(user.run("info", "--json").stdout)["status"]
    assert state["state"] == "loaded" and state["tick"] == 0
    assert user.run("set", "Kp1=1500").returncode == 0
    said = user.run("run")
    assert said.returncode == 0 and "running" in said.stdout, said.stderr
    assert "Kp1 = 1500" in user.run("get", "Kp1").stdout
    assert "program    pd.c (" in user.run("info").stdout


def test_true_is_not_accepted_as_a_number_by_any_command(user: Installed) -> None:
    user.run("run", "runs.c")
    for words in (("a=true",), ("list=[1.0,true,2.0]",), ("list=[true,true,true]", "--no-wait")):
        said = user.run("set", *words)
        assert said.returncode == 2 and "true" in said.stderr.lower(), (words, said)
    assert user.run("set", "on=true", "a=2").returncode == 0
    script = user.script(
        "import numpy as np, zendsp\n"
        "with zendsp.connect('imi') as t:\n"
        "    t['a'] = 3.0; t.update(a=4.0); t.update(a=np.float64(5.0), on=np.bool_(True))\n"
        "    ways = (\n"
        "        lambda v: t.__setitem__('a', v),\n"
        "        lambda v: t.update(a=v),\n"
        "        lambda v: t.stage(a=v),\n"
        "        lambda v: t.update(10**9, a=v),\n"
        "    )\n"
        "    for way in ways:\n"
        "        for value in (True, np.bool_(False)):\n"
        "            try: way(value)\n"
        "            except zendsp.errors.VariableError as e: assert 'not a number' in str(e), e\n"
        "            else: raise SystemExit('taken')\n"
        "    t['a'] = 3; t.update(a=4); assert t.staged == {}\n"
    )
    assert script.returncode == 0, script.stderr


def test_a_mistyped_name_is_told_from_the_names_there_are(user: Installed) -> None:
    user.run("run", "pd.c")
    said = user.run("get", "Kp9")
    assert said.returncode == 2
    assert (
        "did you mean Kp" in said.stderr
        and "13 parameters" in said.stderr
        and "zendsp info" in said.stderr
    )
    script = user.script(
        "import zendsp\n"
        "t = zendsp.connect('imi')\n"
        "try: t.Kp1 = 123\n"
        "except AttributeError as e: assert 'target[\"Kp1\"] = 123' in str(e), e\n"
        "else: raise SystemExit('taken')\n"
        "try: t.Kp1\n"
        "except AttributeError as e: assert 'target[\"Kp1\"]' in str(e), e\n"
        "assert not hasattr(t, 'nonsense')\n"
        "t.close()\n"
    )
    assert script.returncode == 0, script.stderr


def test_a_mistyped_name_does_not_block_matdsp(user: Installed) -> None:
    script = user.script(
        "from zendsp.matdsp import *\n"
        "from zendsp.errors import VariableError\n"
        "MatDSPconnect('imi'); MatDSPdownload('pd.c'); MatDSPstart()\n"
        "MatDSPvariable('Kp1', 450.0)\n"
        "nan = float('nan')\n"
        "wrong = ('Kpp1', 1.0), ('Kp1', 1e9), ('Kp1', nan), ('q1', 1.0), ('Kp1', True)\n"
        "for name, value in wrong:\n"
        "    try: MatDSPvariable(name, value)\n"
        "    except VariableError as e: assert name in str(e)\n"
        "    else: raise SystemExit(f'{name} = {value} taken')\n"
        "MatDSPupdate(); assert MatDSPvariable('Kp1') == 450.0\n"
        "MatDSPvariable('Kp1', 460.0)\n"
        "assert MatDSPdiscard() == {'Kp1': 460.0} and MatDSPdiscard() == {}\n"
        "MatDSPvariable('Kp1', 470.0); MatDSPdownload('runs.c'); MatDSPstart()\n"
        "try: MatDSPupdate()\n"
        "except VariableError as e: assert 'MatDSPdiscard' in ''.join(e.__notes__)\n"
        "MatDSPdiscard(); MatDSPvariable('a', 2.0); MatDSPupdate()\n"
        "assert MatDSPvariable('a') == 2.0\n"
        "MatDSPclose()\n"
    )
    assert script.returncode == 0, script.stderr


@WORDS
def test_programs_are_named_alike_by_every_command(user: Installed) -> None:
    for command in (
        ("compile", "nonsense.c"),
        ("load", "nonsense.c"),
        ("run", "nonsense.c"),
        ("tui", "--source", "nonsense.c"),
        ("simulate", "nonsense.c", "--model", "m.toml"),
    ):
        user.write(
            "m.toml",
            '[mechanism]\nkind = "rotary"\n[mechanism.parameters]\ninertia = 1.0\n[columns]\n'
            'position = "q"\n',
        )
        said = user.run(*command)
        assert said.returncode == 2 and "nonsense.c" in said.stderr and "pd.c" in said.stderr, (
            command, said,
        )
    said = user.run("run", ".")
    assert said.returncode == 2 and "is a folder; name the program in it" in said.stderr, said
    resolved = user.script("from zendsp.cli.tui import found\nprint(found('pd.c'))")
    assert resolved.stdout.strip().endswith("programs/pd.c"), resolved.stderr


def test_what_tripped_is_never_called_merely_stopped(user: Installed) -> None:
    said = user.run("run", "trips.c")
    assert said.stdout == "tripped at sample 0\n", said  # not where the paused clock is now
    assert user.run("pause").stdout == "tripped at sample 0\n"
    assert " tripped " in user.run("ls").stdout
    said = user.run("stop")
    assert said.stdout.count("stopped, at sample 0") == 1 and "computed nan" in said.stdout, said
    refused = user.run("experiment", "friction", "-t", "imi")
    assert refused.returncode == 2 and "acknowledge" in refused.stderr, refused
    assert "program    trips.c (" in user.run("info").stdout  # it was declined whole
    user.run("drive", "acknowledge")
    user.run("run", "runs.c")
    assert user.run("stop").stdout.startswith("stopped, at sample")
    assert user.run("pause").stdout.startswith("stopped at sample")


@WORDS
def test_set_takes_several_values(user: Installed) -> None:
    done = user.run("run", "--set", "Kp1=900", "Kd1=33", "pd.c", "--seconds", "0.1", "--json")
    assert done.returncode == 0, done.stderr
    assert "900" in user.run("get", "Kp1").stdout and "33" in user.run("get", "Kd1").stdout
    wrong = user.run("run", "pd.c", "Kd1=33")
    assert wrong.returncode == 2 and "a value is written --set Kd1=33" in wrong.stderr
    wrong = user.run("run", "pd.c", "track.c")
    assert wrong.returncode == 2 and "one FILE, not 2: pd.c, track.c" in wrong.stderr


@WORDS
def test_refusals_list_what_is_available(user: Installed) -> None:
    user.write("unlinked.c", RUNS.replace("INT2(void) {}", "INT2(void) { absent(); }"))
    said = user.run("compile", "unlinked.c")
    assert "undefined reference to" in said.stderr and ":0:" not in said.stderr, said
    assert f"unlinked.c:{len(RUNS.splitlines())}: error: undefined reference" in said.stderr
    user.write("macro.c", RUNS.replace('PARAMETER(on, 0, "", 0, 1, "")', 'PARAMETER(on, 0, "")'))
    said = user.run("compile", "macro.c")
    assert "PARAMETER" in said.stderr and ":-1:" not in said.stderr, said
    user.run("run", "runs.c")
    said = user.run("bode")
    assert said.returncode == 2 and "it declares no signal" in said.stderr, said
    script = user.script("import zendsp\nzendsp.local('imi_planer')\n")
    # a busy computer says first that it is starting
    said = script.stderr.partition("the target did not start: zendsp target: ")[2]
    assert "no machine 'imi_planer'" in said, script.stderr
    assert ".c file" in said and "(.xml, .urdf)" in said, said
    for command in ("info", "stop"):
        said = user.run(command, "-t", "nobody")
        assert "ZENDSP_CONNECT=" in said.stderr and "--connect" not in said.stderr, said


def test_info_says_whose_run_moves_a_machine_that_nobody_commands(user: Installed) -> None:
    user.run("run", "pd.c")
    script = user.script(
        "import subprocess, sys, zendsp\n"
        "from zendsp.link.put_back import kept\n"
        "with zendsp.connect('imi') as t:\n"
        "    ask = [sys.argv[1], 'drive']\n"
        "    with kept(t, ['Kp1'], moves=True):\n"
        "        print(subprocess.run(ask, capture_output=True, text=True).stdout)\n"
        "        print(t.link.author, t.drive_status().moved_by)\n"
        "    assert t.drive_status().moved_by == ''\n",
        str(user.zendsp),
    )
    assert script.returncode == 0, script.stderr
    *status, last, names = script.stdout.strip().splitlines()
    author, mover = names.split()
    assert author == mover
    assert last == "" and status[-1].startswith(f"commanded by nobody, moved by {author};")


def test_the_end_of_a_host_is_not_logged_as_trouble_of_the_target(installed: Installed) -> None:
    target = installed.target("imi")
    script = installed.script(
        "import zendsp\n"
        "t = zendsp.connect('imi')\n"
        "t.download('pd.c'); t.power_on(); t.home_and_wait(); t.enable(); t.start()\n"
    )
    assert script.returncode == 0, script.stderr
    until(lambda: "is gone" in installed.run("info").stderr, "the policy acts", alive=target)
    time.sleep(AFTER_TRIP_S + 0.5)  # when the recorder would be ended; nothing tells that it was
    os.killpg(target.pid, signal.SIGTERM)
    said, _ = target.communicate(timeout=PATIENCE_S)
    assert "listens on" in said and "WARNING" not in said, said
