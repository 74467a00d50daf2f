"""User code starts nothing that outlives it, and nothing that could drive the machine in its place.
"""

from __future__ import annotations

import os
import pty
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from attempts import attempting
from samples import run
from waiting import PATIENCE_S, until

from zendsp_isr.confine import landlock_version
from zendsp_protocol.errors import Refused
from zendsp_target.runtime import Runtime
from zendsp_target.runtime.process.strays import Strays

Make = Callable[..., Runtime]

WAYS = {
    "fork": "const pid_t p = fork(); if (p == 0) started(); return p;",
    "double_fork": (
        "const pid_t p = fork(); if (p == 0) { setsid(); if (fork() == 0) started(); _exit(0); }"
        " return p;"
    ),
    "vfork": (
        'const pid_t p = vfork(); if (p == 0) { execvp("sleep", sleeper); _exit(0); } return p;'
    ),
    "raw_clone": (
        "const long p = syscall(SYS_clone, SIGCHLD, 0, 0, 0, 0); if (p == 0) started(); return p;"
    ),
    "raw_clone3": (
        "unsigned long a[8] = {0, 0, 0, 0, SIGCHLD}; const long p = syscall(SYS_clone3, a, sizeof"
        " a); if (p == 0) started(); return p;"
    ),
    "spawn": (
        'pid_t p = -1; const int e = posix_spawnp(&p, "sleep", NULL, NULL, sleeper, environ);'
        " if (e) errno = e; return e ? -1 : p;"
    ),
    "system": 'return system("sleep %(mark)s &") == 0 ? 1 : -1;',
    "exec": 'return execvp("sleep", sleeper);',
    "bomb": (
        "long n = 0; for (int i = 0; i < 50; i++) { const pid_t p = fork(); if (p == 0) started();"
        " n += p; } return n;"
    ),
}


def _left(mark: str) -> list[int]:
    """Processes whose command line has the mark."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if mark.encode() in (folder / "cmdline").read_bytes().split(b"\0"):
                found.append(int(folder.name))
        except OSError:
            continue
    return found


@pytest.fixture
def mark() -> str:
    """The seconds that a process would sleep that got away; no other has this number."""
    return f"{300 + time.time_ns() % 1_000_000_000 / 1e9:.9f}"


@pytest.mark.parametrize("where", ["constructor", "init", "isr"])
@pytest.mark.parametrize("way", list(WAYS))
def test_user_code_starts_no_process(make_runtime: Make, way: str, where: str, mark: str) -> None:
    runtime = make_runtime(attempting(WAYS[way], mark, where))
    run(runtime, 3)
    assert _left(mark) == []
    values = runtime.read(["answer", "refused"])[1]
    assert values["answer"] < 0.0, values
    runtime.close()
    assert _left(mark) == []


def test_user_code_starts_no_thread(make_runtime: Make, mark: str) -> None:
    how = (
        "static pthread_t t; return -(long)pthread_create(&t, NULL, (void *(*)(void *))started,"
        " NULL);"
    )
    runtime = make_runtime(attempting(how, mark, "init"))
    assert runtime.read(["answer"])[1]["answer"] < 0.0


@pytest.mark.skipif(landlock_version() < 1, reason="the kernel has no Landlock")
@pytest.mark.parametrize("where", ["constructor", "init", "isr", "background"])
def test_user_code_writes_the_memory_of_no_other_process(
    make_runtime: Make, wait_for: Callable[..., None], where: str
) -> None:
    """The parent of the runner is the target, which is this very test here."""
    attempt = "static void attempt(void) { if (!tried) { tried = 1; got = reach(); } }"
    called = {w: "attempt();" if w == where else "" for w in ("init", "isr", "background")}
    constructor = "__attribute__((constructor))" if where == "constructor" else ""
    runtime = make_runtime(
        f"""
        #include "isr.h"
        #include <fcntl.h>
        #include <stdio.h>
        #include <unistd.h>
        static double got = 0.0, tried;
        static double reach(void) {{
            char path[64];
            snprintf(path, sizeof path, "/proc/%d/mem", getppid());
            return open(path, O_RDWR) < 0 ? 1.0 : -1.0;
        }}
        {constructor} {attempt}
        void UserInit(void) {{ SIGNAL(got, "", ""); SIGNAL(tried, "", ""); {called["init"]} }}
        void UserISR_INT2(void) {{ {called["isr"]} }}
        void UserBackground(void) {{ {called["background"]} }}
        """
    )
    runtime.start()
    wait_for(lambda: runtime.read(["got"])[1]["got"] != 0.0)
    assert runtime.read(["got"])[1]["got"] == 1.0, "it reached what is the target's"


def test_user_code_ends_no_other_process(make_runtime: Make, mark: str) -> None:
    other = subprocess.Popen(["sleep", "300"])
    try:
        # Signal 0 only asks for the right to send one: where nothing holds this program, everything
        # else must live on.
        how = f"return kill({other.pid}, SIGKILL) & kill(getppid(), 0) & kill(-1, 0);"
        runtime = make_runtime(attempting(how, mark, "init"))
        assert runtime.read(["answer", "refused"])[1] == {"answer": -1.0, "refused": 1.0}
        assert other.poll() is None
    finally:
        other.kill()
        other.wait()


# how a program could end another process, or take its time, without a signal of its own
REACHES = {
    "limit": (
        "const struct rlimit none = {{1, 1}}; return prlimit({other}, RLIMIT_CPU, &none, NULL);"
    ),
    "owner": (
        "int p[2]; if (pipe(p) != 0) return 1; fcntl(p[0], F_SETFL, O_ASYNC | O_NONBLOCK);"
        " fcntl(p[0], F_SETSIG, SIGKILL); if (fcntl(p[0], F_SETOWN, {other}) != 0) return -1;"
        ' return write(p[1], "x", 1);'
    ),
    "owner_of_a_thread": (
        "const struct f_owner_ex o = {{F_OWNER_PID, {other}}}; int p[2]; if (pipe(p) != 0) return"
        " 1; fcntl(p[0], F_SETFL, O_ASYNC | O_NONBLOCK); fcntl(p[0], F_SETSIG, SIGKILL); if"
        ' (fcntl(p[0], F_SETOWN_EX, &o) != 0) return -1; return write(p[1], "x", 1);'
    ),
    "ioctl": (
        "int s[2], on = 1, who = {other}; if (socketpair(AF_UNIX, SOCK_STREAM, 0, s) != 0) return"
        " 1; ioctl(s[0], FIOASYNC, &on); fcntl(s[0], F_SETSIG, SIGKILL); if (ioctl(s[0],"
        ' FIOSETOWN, &who) != 0) return -1; return write(s[1], "x", 1);'
    ),
    "scheduling": (
        "const struct sched_param none = {{0}}; return sched_setscheduler({other}, SCHED_IDLE,"
        " &none);"
    ),
    "attributes": (
        "unsigned long a[6] = {{48 | 5ul << 32}}; return syscall(SYS_sched_setattr, {other}, a, 0);"
    ),
    "processors": (
        "const unsigned long first = 1; return sched_setaffinity({other}, 8, (cpu_set_t *)&first);"
    ),
    "priority": "return setpriority(PRIO_PROCESS, {other}, 19);",
    # of a user without processes: where nothing holds this program, it lowers every one of a user
    "priority_of_a_user": "return setpriority(PRIO_USER, 54321, 19);",
    "disk": "return syscall(SYS_ioprio_set, 1, {other}, 3 << 13);",
    # whose shell would carry out what is typed there
    "terminal": (
        'const int t = open("{terminal}", O_RDWR | O_NOCTTY); return ioctl(t, TIOCSTI, "x");'
    ),
    "ring": "char none[120] = {{0}}; return syscall(SYS_io_uring_setup, 1, none);",
}


def _treated(pid: int) -> tuple[object, ...]:
    """How the kernel treats a process."""
    return (
        resource.prlimit(pid, resource.RLIMIT_CPU),
        os.sched_getscheduler(pid),
        os.sched_getaffinity(pid),
        os.getpriority(os.PRIO_PROCESS, pid),
    )


@pytest.mark.parametrize("way", list(REACHES))
def test_user_code_reaches_no_other_process(make_runtime: Make, way: str, mark: str) -> None:
    master, terminal = pty.openpty()
    other = subprocess.Popen(["sleep", "300"], stdin=terminal)
    try:
        before = _treated(other.pid)
        how = REACHES[way].format(other=other.pid, terminal=os.ttyname(terminal))
        runtime = make_runtime(attempting(how, mark, "init"))
        assert runtime.read(["answer", "refused"])[1] == {"answer": -1.0, "refused": 1.0}
        assert other.poll() is None
        assert _treated(other.pid) == before
    finally:
        other.kill()
        other.wait()
        os.close(master)
        os.close(terminal)


STRAYS = {
    "session": (
        'if (fork_raw() == 0) { setsid(); if (fork_raw() == 0) execvp("sleep", sleeper);'
        " _exit(0); }"
    ),
    "bare": (
        'if (fork_raw() == 0) { setsid(); if (fork_raw() == 0) execve("/bin/sleep", sleeper,'
        " nothing); _exit(0); }"
    ),
    "group": 'if (fork_raw() == 0) execvp("sleep", sleeper);',
}
RAW = (
    "static char *const nothing[] = {NULL};\n"
    "static long fork_raw(void) { return syscall(SYS_clone, SIGCHLD, 0, 0, 0, 0); }\n"
)


@pytest.mark.skipif(
    os.getuid() != 0, reason="an ordinary user's program cannot start processes, filter or not"
)
@pytest.mark.parametrize("way", list(STRAYS))
@pytest.mark.parametrize("end", ["close", "load", "crash", "orphan"])
def test_without_a_filter_what_user_code_started_ends_with_it(
    tmp_path: Path, mark: str, way: str, end: str
) -> None:
    program = attempting(f"{STRAYS[way]} return 1;", mark, "init").replace(
        "static int started", RAW + "static int started"
    )
    (tmp_path / "user.c").write_text(
        program.replace("answer = (double)attempt()", "answer = (double)attempt(); (void)nothing")
    )
    command = [
        sys.executable,
        str(Path(__file__).with_name("unfiltered.py")),
        str(tmp_path / "user.c"),
        end,
    ]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        try:
            said = process.stdout.readline()
            assert "NO FILTER OF SYSTEM CALLS" in said, said
            until(lambda: _left(mark), "it started a process, so that its end means something")
            process.stdin.write("look\n")
            process.stdin.flush()
            if end == "orphan":
                process.wait(PATIENCE_S)
            else:
                assert process.stdout.readline() == "ended\n"
            until(lambda: not _left(mark), "it has ended")
        finally:
            process.kill()
            for left in _left(mark):
                os.kill(left, signal.SIGKILL)


def test_user_code_takes_no_more_memory_than_it_is_given(make_runtime: Make, mark: str) -> None:
    how = "long most = 0; while (most < 4000 && malloc(1 << 20)) most++; errno = 0; return most;"
    runtime = make_runtime(attempting(how, mark, "init"), memory_mb=200.0)
    assert 100.0 < runtime.read(["answer"])[1]["answer"] < 200.0
    huge = "static volatile char huge[1 << 30]; void fill(void) { huge[0]++; }"
    with pytest.raises(Refused, match="variables take 1074 MB, and user code may take 200 MB"):
        make_runtime(attempting("return 0;", mark, "init") + huge, memory_mb=200.0)
    with pytest.raises(Refused, match="give 50 or more"):
        make_runtime(attempting("return 0;", mark, "init"), memory_mb=1.0)


def test_it_is_said_what_holds_user_code(make_runtime: Make, mark: str) -> None:
    runtime = make_runtime(attempting("return -1;", mark, "init"), clock="real")
    assert "user code starts nothing" in runtime.status().scheduling


def test_running_out_of_files_while_searching_a_runners_children_does_no_harm() -> None:
    # what comes after it makes the machine safe
    most = resource.getrlimit(resource.RLIMIT_NOFILE)
    strays = Strays(os.getpid(), "a mark that nobody has")
    resource.setrlimit(resource.RLIMIT_NOFILE, (3, most[1]))
    try:
        strays.look()
        strays.end()
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, most)
