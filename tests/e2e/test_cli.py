"""The command line as a user has it: real targets, exit codes, JSON that parses.

Commands that run on are processes of their own; the others are called in this process, which saves
half a second each. tests/journeys types all of them as users do.
"""

from __future__ import annotations

import contextlib
import io
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import pytest
from waiting import PATIENCE_S, until

import zendsp
from zendsp.cli import info, main
from zendsp.cli.common import parse_value
from zendsp.errors import Tripped
from zendsp.link import Target
from zendsp_protocol import messages as m
from zendsp_protocol.states import ProgramState


def zendsp_(*arguments: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    with (
        pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err, pytest.raises(SystemExit) as ended,
    ):  # fmt: skip
        patch.setattr(sys, "argv", ["zendsp", *arguments])
        if cwd is not None:
            patch.chdir(cwd)
        main()
    code = ended.value.code
    status = code if isinstance(code, int) else int(code is not None)
    return subprocess.CompletedProcess(arguments, status, out.getvalue(), err.getvalue())


def process_of(*arguments: str) -> subprocess.CompletedProcess[str]:
    """The process of a command that replaces itself by another program."""
    command = [sys.executable, "-m", "zendsp", *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE_S)


def answer(*arguments: str) -> Any:
    done = zendsp_(*arguments, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.fixture
def target(fast: Target) -> Iterator[Target]:
    yield fast


def test_a_session_at_the_command_line(target: Target, tmp_path: Path) -> None:
    assert [found["name"] for found in answer("ls")] == [target.name]
    assert "load one with zendsp run" in zendsp_("info").stdout  # nothing runs yet
    assert answer("compile", "pd.c")["ok"] is True
    assert answer("run", "pd.c", "--set", "Kp1=900", "--seconds", "0.5")["tick"] == 500
    assert answer("get", "Kp1")["values"] == {"Kp1": 900.0}
    assert answer("set", "Kp1=450", "use_table=false")["tick"] == 500
    parameters = tmp_path / "good.json"
    assert answer("params", "save", str(parameters))["count"] == 13
    assert answer("params", "diff", str(parameters)) == []
    answer("set", "Kp1=1")
    differs = zendsp_("params", "diff", str(parameters), "--json")
    assert differs.returncode == 1 and json.loads(differs.stdout) == [
        {"name": "Kp1", "file": 450.0, "other": 1.0}
    ]
    answer("params", "restore", str(parameters))
    out = tmp_path / "run.npz"
    assert answer("acquire", "q", "tau", "-s", "1", "-o", str(out), "--start")["rows"] == 1000
    assert zendsp.Recording.load(out).parameters["Kp1"] == 450.0
    assert answer("info")["machine"]["name"] == "imi_planar"
    assert answer("info", target.name)["values"]["Kp1"] == 450.0
    assert re.search(r"Kp1 +double +parameter +450 +N m/rad", zendsp_("info").stdout)
    assert answer("stats")["timing"]["ticks"] >= 1500
    assert "execution" in zendsp_("stats").stdout
    assert answer("pause")["state"] == "paused"
    assert answer("run")["state"] == "running"
    wrong = zendsp_("stop", "nobody")
    assert wrong.returncode != 0 and target.status().state == "running"
    assert answer("stop", target.name)["state"] in ("running", "stopped")
    until(lambda: target.status().state == "stopped", "the STOP is in force")
    assert answer("stop", "--acknowledge")["trip"] is None
    answer("run")
    answer("stop")  # whatever there is of this user's
    until(lambda: target.status().state == "stopped", "without a name too")
    answer("stop", "--acknowledge")
    answer("run")
    both = zendsp_("stop", "nobody", target.name)
    assert both.returncode != 0 and "nobody: NOT STOPPED" in both.stderr
    assert target.status().state == "stopped", "a wrong name holds up no other"


OBEYED = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]")  # by a terminal
RUDE = r"""
#include "isr.h"
static double x;
void UserInit(void) {
    SIGNAL(x, "\x1b]0;owned\a", "\x1b[2J\x1b[31mSTOPPED\x1b[8m\xe2\x80\xaegone\r\xc2\x9b" "2J");
}
void UserISR_INT2(void) { x = 1.0; }
"""


def test_info_tells_who_commands_and_what_the_loss_of_that_host_does(target: Target) -> None:
    assert "\ncommand " not in zendsp_("info").stdout
    target.take_command()
    target.set_host_lost("finish")
    line = f"command    {target.link.author}; if that host is lost: finish\n"
    assert line in zendsp_("info").stdout + "\n"


def test_no_text_of_a_program_or_of_a_file_commands_the_terminal(
    target: Target, tmp_path: Path
) -> None:
    (tmp_path / "rude.c").write_text(RUDE)
    target.download(tmp_path / "rude.c")
    info = zendsp_("info").stdout
    assert "STOPPED" in info and not OBEYED.search(info)
    (seen,) = target.variables().values()
    assert "STOPPED" in seen.description and not OBEYED.search(seen.unit + seen.description)
    model = tmp_path / "rude.toml"
    model.write_text('name = "\\u001b[2J"\n[mechanism]\nkind = "\\u001b[31m"\n')
    refused = zendsp_("model", "check", str(model))
    assert refused.returncode == 2 and "31m" in refused.stderr and not OBEYED.search(refused.stderr)


BOMB = "".join(
    f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' if i else '<!ENTITY a0 "lol">' for i in range(12)
)
CHAIN = "".join(
    f'<link name="l{i}"/><joint name="j{i}" type="fixed"><parent link="l{i}"/>'
    f'<child link="l{i + 1}"/></joint>'
    for i in range(3000)
)


@pytest.mark.parametrize(
    ("urdf", "words"),
    [
        (None, "no such file beside the model"),
        ("<robot", "is not a URDF"),
        ("<mujoco/>", 'a.urdf: is not a URDF: its root is <mujoco>, not <robot>; a MuJoCo'),
        (f'<!DOCTYPE r [{BOMB}]><robot name="&a11;"/>', "amplification"),
        ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>', "entity"),
        (f'<robot name="r">{CHAIN}<link name="l3000"/></robot>', "too long to be read"),
        (f'<robot name="r">{"<a>" * 90000}{"</a>" * 90000}</robot>', "has no <link>"),
    ],
    ids=["missing", "cut", "mujoco", "bomb", "foreign file", "endless chain", "deep"],
)
def test_a_check_of_a_model_reads_its_urdf(tmp_path: Path, urdf: str | None, words: str) -> None:
    (tmp_path / "arm.toml").write_text('name = "a"\n[mechanism]\nkind = "urdf"\nfile = "a.urdf"\n')
    if urdf is not None:
        (tmp_path / "a.urdf").write_text(urdf)
    checked = zendsp_("model", "check", str(tmp_path / "arm.toml"))
    assert checked.returncode == 2 and words in checked.stderr, checked.stderr[-300:]
    assert "Traceback" not in checked.stderr


def test_failures_are_one_sentence_and_an_exit_code(target: Target, tmp_path: Path) -> None:
    bad = tmp_path / "bad.c"
    bad.write_text('#include "isr.h"\nvoid UserInit(void) { oops }\n')
    for arguments, code, words in (
        (["compile", str(bad)], 1, "bad.c:2:"),
        (["run", str(bad)], 1, "bad.c:2:"),
        (["get", "Kp1"], 2, "no program is loaded"),
        (["set", "Kp1"], 2, "expected NAME=VALUE"),
        (["set", "Kp1=x"], 2, "is not a value"),
        (["info", "-t", "nobody"], 2, "no target named 'nobody'"),
        (["ls", "x*"], 1, ""),
        (["params", "restore", str(bad)], 2, "not a parameter set"),
    ):
        done = zendsp_(*arguments)
        assert done.returncode == code, (arguments, done.returncode, done.stderr)
        assert words in done.stderr and "Traceback" not in done.stderr, (arguments, done.stderr)


def test_what_was_recorded_before_a_crash_is_saved_and_a_wrong_name_is_refused_before_the_recording(
    target: Target, tmp_path: Path
) -> None:
    crash = tmp_path / "crash.c"
    crash.write_text(
        '#include "isr.h"\nstatic double x; static int *volatile nowhere;\n'
        'void UserInit(void) { SIGNAL(x, "", "counts"); }\n'
        "void UserISR_INT2(void) { if (++x > 700) *nowhere = 1; }\n"
    )
    target.download(crash)
    for wrong in (["-o", "run.xyz"], ["-o", "run.npz", "--plot", "run.xyz"]):
        refused = zendsp_("acquire", "x", "-s", "1", "--start", *wrong, cwd=tmp_path)
        assert (
            refused.returncode == 2
            and "Traceback" not in refused.stderr
            and ".xyz" in refused.stderr
        )
    assert target.status().tick == 0, "nothing was started for them"
    out = tmp_path / "run.npz"
    done = zendsp_("acquire", "x", "-s", "1", "-o", str(out), "--start", "--json")
    assert (
        done.returncode == 1 and "SIGSEGV" in done.stderr and "acquire_load" not in done.stderr
    ), done.stderr
    assert "crash.c:4" in json.loads(done.stdout)["ended"]
    assert zendsp.Recording.load(out)["x"].tolist() == [float(k) for k in range(1, 701)]
    # a crash is told at the end of what follows, but not in place of another error
    assert zendsp_("get", "x").stderr.count("SIGSEGV") == 1
    crash.write_text('#include "isr.h"\nvoid UserISR_INT2(void) { nothing(); }\n')
    for wrong in (["run", str(crash)], ["get", "nothing"], ["set", "nothing=1"]):
        failed = zendsp_(*wrong)
        assert failed.returncode in (1, 2) and "nothing" in failed.stderr
        assert "SIGSEGV" not in failed.stderr, failed.stderr


@pytest.mark.parametrize("clock", ["fast", "real"])
def test_how_the_machine_comes_to_rest_after_a_trip_is_recorded(
    start: Any, tmp_path: Path, clock: str
) -> None:
    nan = tmp_path / "nan.c"
    nan.write_text(
        '#include "isr.h"\nstatic double x;\n'
        'void UserInit(void) { SIGNAL(x, "", "counts"); }\n'
        "void UserISR_INT2(void) { WRITE_TORQUE(0, ++x > 700 ? NAN : 0.0); }\n"
    )
    speed = ["--speed", "5"] if clock == "fast" else []
    target = start(clock=clock, options=["--no-realtime", *speed])
    target.download(nan)
    out = tmp_path / "run.npz"
    for seconds, words in (("9", "({} of 9000 rows)"), ("0.8", "stopped within the recording")):
        done = zendsp_("acquire", "x", "-s", seconds, "-o", str(out), "--start", "--json")
        rows = len(zendsp.Recording.load(out))
        assert done.returncode == 1 and words.format(rows) in json.loads(done.stdout)["ended"]
        assert 1700 <= rows < 9000 or rows == 800, "a second after the trip, and one count of it"
        target.acknowledge()
        target.download(nan)


@pytest.mark.long("each command writes elsewhere; lost: into a new folder")
def test_an_output_path_in_a_new_folder_creates_the_folder(target: Target, tmp_path: Path) -> None:
    target.download("pd.c")
    target.start()
    sweep = ("sweep", "Kp1=500,600", "-c", "e1", "-s", "0.1", "--settle", "0.1", "--out")
    for number, command in enumerate((
        ("params", "save", "{}/x.json"),
        ("acquire", "q", "tau", "--seconds", "3", "--out", "{}/run.csv"),
        (*sweep, "{}/s.csv"),
        ("model", "new", "1/run.csv", "--out", "{}/m.toml"),
        ("model2c", "imi_planar.toml", "--out", "{}/m.c"),
        ("reference", "circle", "--out", "{}/c.mat", "--plot", "{}/plot/c.png"),
    )):  # fmt: skip
        done = zendsp_(*(word.format(number) for word in command), cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert (tmp_path / command[-1].format(number)).is_file()
    (tmp_path / "file").touch()
    done = zendsp_(*sweep, "file/s.csv", cwd=tmp_path)
    assert done.returncode == 2 and "cannot be written" in done.stderr
    assert "rms e1" in done.stdout, "what was measured is seen"


def test_a_joint_outside_its_limit_is_reported_until_it_is_back_inside(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    target.download("pd.c")
    target.update(radius=1.0, center2=1.4)  # joint 2 is led to 2.4 rad, and trips at 2.15
    with contextlib.suppress(Tripped):  # of a host that looks late
        target.start()
    until(lambda: target.status().trip, "tripped")
    said = re.compile(
        r"joint 2 is 0\.\S+ rad outside its limit of 2\.15 rad: (acknowledge"
        r" \(zendsp drive acknowledge\), then )?home the machine \(zendsp drive home\)"
    )
    for tripped in (True, False):
        for command in (("info",), ("drive",)):
            found = said.search(zendsp_(*command).stdout)
            assert found and bool(found[1]) == tripped, command
        assert len(answer("info")["outside"]) == 1
        zendsp_("drive", "acknowledge")
    monkeypatch.setenv("ZENDSP_PROGRESS", "lines")
    done = zendsp_("drive", "home")  # a machine that does not arrive is waited for for a minute
    assert done.returncode == 0 and "homing; Ctrl-C ends it" in done.stderr
    assert not said.search(zendsp_("info").stdout + zendsp_("drive").stdout)


def test_a_planned_motion_is_shown_beside_the_limits() -> None:
    shown = zendsp_("reference", "point_to_point", "--machine", "imi_planar").stdout
    assert "limit    -2.1500     2.1500     6.280     55.00   245.000" in shown
    assert shown.count("limit  ") == 2  # of each joint


def test_a_file_that_is_no_c_program_is_refused_by_name(target: Target, tmp_path: Path) -> None:
    (tmp_path / "bad.mat").write_text("no C")
    done = zendsp_("compile", "bad.mat", cwd=tmp_path)
    assert done.returncode != 0 and "bad.mat" in done.stderr and "ends in .c" in done.stderr


def test_a_failed_compile_says_that_the_running_program_goes_on(
    target: Target, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.c"
    bad.write_text("void UserISR_INT2(void) { tau = ; }\n")
    target.download("pd.c")
    assert "goes on" not in zendsp_("load", str(bad)).stderr
    target.start()
    done = zendsp_("run", str(bad))
    assert done.returncode == 1 and "what was loaded before goes on running" in done.stderr
    assert target.status().state == "running"


def test_a_program_that_is_long_in_loading_is_said_to_load(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A UserInit without end was silent for 10 s."""
    monkeypatch.setenv("ZENDSP_PROGRESS", "lines")  # on a terminal: one line
    assert "compiling and loading" in zendsp_("load", "pd.c").stderr
    assert "compiling" not in zendsp_("load", "pd.c", "--json").stderr


def test_a_failed_load_says_that_the_program_before_was_ended(
    target: Target, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.c"
    bad.write_text(
        '#include "isr.h"\nstatic double x;\nvoid UserISR_INT2(void) {}\n'
        'void UserInit(void) { PARAMETER(x, 9.0, "", 0.0, 1.0, "beyond"); }\n'
    )
    assert "was ended" not in zendsp_("run", str(bad)).stderr, "there was none"
    target.download("pd.c")
    target.start()
    done = zendsp_("run", str(bad))
    assert done.returncode != 0 and "outside its limits" in done.stderr
    assert "what was loaded before was ended" in done.stderr
    assert target.status().state == "empty"


def test_a_value_that_is_refused_does_not_end_the_program_that_runs_in_silence(
    target: Target, tmp_path: Path
) -> None:
    other = tmp_path / "other.c"
    other.write_text(
        '#include "isr.h"\nstatic double x;\nvoid UserISR_INT2(void) {}\n'
        'void UserInit(void) { PARAMETER(x, 0.0, "", 0.0, 1.0, ""); }\n'
    )
    zendsp_("run", "pd.c")
    for wrong in ("Kp1=1e9", "Kq1=3"):  # the same program: checked first
        done = zendsp_("run", "pd.c", "--set", wrong)
        assert done.returncode and "what was loaded before goes on running" in done.stderr
        assert target.status().state == "running"
    done = zendsp_("run", str(other), "--set", "x=2")  # its limits are known once it is loaded
    assert done.returncode and "outside its limits" in done.stderr
    assert "other.c is loaded and not started; what was loaded before was ended" in done.stderr
    assert target.status().state == "loaded"


def test_run_warns_of_a_program_that_misses_every_deadline(tmp_path: Path) -> None:
    slow = tmp_path / "slow.c"
    slow.write_text(
        '#include "isr.h"\n#include <time.h>\nvoid UserInit(void) {}\n'
        "void UserISR_INT2(void) { nanosleep(&(struct timespec){.tv_nsec = 3000000}, 0); }\n"
    )
    with zendsp.local("imi_planar", timeout=PATIENCE_S) as target:
        done = zendsp_("run", str(slow), "-t", target.name)
        assert done.stdout == "running; it goes on until 'zendsp pause' or 'zendsp stop'\n"
        assert "samples took longer than the period of 1 ms: shorten UserISR_INT2" in done.stderr


def test_ls_warns_that_a_target_elsewhere_may_refuse_a_password() -> None:
    done = zendsp_("ls", "nobody-*", "--connect", "tcp/127.0.0.1:9")
    assert done.returncode == 1
    for said in ("'nobody-*'", "tcp/127.0.0.1:9", "refuses the certificate or password"):
        assert said in done.stdout


def test_a_measurement_that_is_refused_does_not_first_say_what_it_will_do(target: Target) -> None:
    zendsp_("run", "pd.c")
    for words in (
        "sweep nix=1,2 -c e1 -s 1", "sweep Kp1=900,1000 -c nix -s 1", "bode --f-max 600",
        "bode --output nix", "bode --f-min 0",
    ):
        done = zendsp_(*words.split())
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1, done.stderr
    words = "sweep Kp1=900 -c e1 -s 0.2 --settle 0.1 --fade 0.1"
    done = zendsp_(*words.split())
    assert done.stderr.startswith("sweep of 1 run, ") and done.returncode == 0


def test_a_faded_value_is_told_with_the_end_of_its_fade(target: Target) -> None:
    zendsp_("run", "pd.c")
    assert zendsp_("set", "Kp1=900", "--fade", "0.1").stdout.endswith(", the end of the fade\n")
    assert "fade" not in zendsp_("set", "Kp1=950").stdout


def test_ls_says_where_none_answers_beside_the_targets_that_do(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENDSP_CONNECT", "tcp/127.0.0.1:9")
    done = zendsp_("ls")
    assert target.name in done.stdout and done.returncode == 1
    assert done.stderr.startswith("zendsp: no target answers at tcp/127.0.0.1:9; ")
    monkeypatch.delenv("ZENDSP_CONNECT")
    assert zendsp_("ls").stderr == ""


@pytest.mark.parametrize(
    "words",
    [
        "reference circle --radius 0,15", "reference point_to_point --machine pendulum --goal 0,15",
        "simulate pd.c --model imi_planar.toml --seconds 0,15",
        "simulate pd.c --model imi_planar.toml --set Kp1=0,15", "run --seconds 0,15",
        "target --rate 0,15", "target --speed 0,15", "target --machine-option q1=0,15",
    ],
)  # fmt: skip
def test_a_decimal_comma_is_refused_with_the_number_that_was_meant(words: str) -> None:
    said = process_of(*words.split()) if words.startswith("target") else zendsp_(*words.split())
    assert said.returncode == 2 and "with a decimal point it is 0.15" in said.stderr, said.stderr


def test_numbers_parted_by_a_comma_may_have_been_meant_as_an_array() -> None:
    with pytest.raises(click.BadParameter, match=r"an array is written \[20000, 600\]"):
        parse_value("20000,600")


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (
            "reference multisine --amplitude 1.2 --amplitude=0.1",
            "several numbers are written --amplitude 1.2,0.1",
        ),
        ("acquire q -s 1 --seconds 2 -o x.mat", "give it once"),
        ("keys user anna --role tune --role observe", "give it once"),
    ],
)
def test_an_option_with_one_value_that_is_given_twice_is_refused(words: str, meant: str) -> None:
    """The last one held, silently, for all joints."""
    said = zendsp_(*words.split()).stderr
    assert "is given more than once and takes one value: " + meant in said


@pytest.mark.parametrize("option", ["--pre 0.1", "--level 0.0", "--edge rising"])
def test_what_belongs_to_a_trigger_is_refused_without_one(option: str) -> None:
    said = zendsp_("acquire", "q", "-s", "1", "-o", "x.mat", *option.split())
    name = option.split()[0]
    assert said.returncode == 2
    assert f"{name} belongs to a trigger: name what is waited for, --trigger SOURCE" in said.stderr


def test_target_refuses_a_wrong_option_in_one_line() -> None:
    done = process_of("target", "--nam", "bench", "--list")
    assert done.returncode == 2
    assert done.stderr.strip().splitlines() == [
        "zendsp target: unrecognized arguments: --nam bench --list; 'python -m zendsp_target"
        " --help' lists the options"
    ]


def test_an_acquisition_larger_than_memory_is_refused_in_words() -> None:
    """For 12 days the refusal had read "too little memory (((1000000000, 4), dtype('float64')))".
    """
    code = "import numpy, zendsp.cli.entry as c; c.cli = lambda **_: numpy.empty(10**17); c.main()"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 2
    assert "too little memory (Unable to allocate" in done.stderr, done.stderr


TRIPS = """#include "isr.h"
static bool wrong;
void UserInit(void) { PARAMETER(wrong, 0, "", 0, 1, "writes NaN"); }
void UserISR_INT2(void) { WRITE_TORQUE(0, wrong ? NAN : 0.0); }
"""


def test_set_says_that_the_new_value_has_tripped_the_machine() -> None:
    with zendsp.local("imi_planar") as target:  # the clock is real: the trip comes after the answer
        target.download({"trips.c": TRIPS})
        target.start()
        said = zendsp_("set", "wrong=true", "-t", target.name)
    assert "wrong set at sample" in said.stdout
    assert "tripped" in said.stderr and "computed nan" in said.stderr


@pytest.mark.parametrize(("overruns", "missed", "told"), [(0, 0, ""), (9, 0, ""), (40, 90, "late")])
def test_info_tells_samples_that_are_late(overruns: int, missed: int, told: str) -> None:
    """At a mean lateness of 24 periods it had said "running", and nothing more."""
    timing = m.Timing(ticks=1000, overruns=overruns, missed=missed)
    status = m.Status(state=ProgramState.RUNNING, timing=timing)
    who: Any = SimpleNamespace(name="imi", hostname="lab", pid=1, versions={})
    said = info._text(who, status, None, {}, {}, (), ())
    late = "late       40 of 1000 samples took longer than the period, 90 were left out"
    assert (late in said) is bool(told) and ("\nlate" in said) is bool(told)
