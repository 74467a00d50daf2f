"""Compiling what a stranger sends takes no more than its limits, ends with all that it started, and
shows no other file.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from waiting import until

from zendsp_isr import build, compiler, sources
from zendsp_isr.confine import landlock_version
from zendsp_isr.messages import Message, parse_messages, where_it_lacks
from zendsp_target.runtime.compile_service import compile_program

HEAD = (
    '#include "isr.h"\nstatic double x;\nvoid UserInit(void) { SIGNAL(x, "", ""); }\n'
    "void UserISR_INT2(void) { x = 1.0; }\n"
)
EXITING = 4  # PF_EXITING of the kernel
SECRET = "root_x_secret_7113"

# an ordinary user, too, where the system lets it have namespaces
needs_root_of_its_own = pytest.mark.skipif(
    subprocess.run(["unshare", "-rm", "true"], check=False).returncode != 0,
    reason="no namespaces here",
)
needs_landlock = pytest.mark.skipif(landlock_version() < 1, reason="this kernel has no Landlock")


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    """A file that the target may read and nobody else."""
    path = tmp_path / "secret"
    path.write_text(f"{SECRET}:$6$hash:19000:0\n")
    path.chmod(0o600)
    return path


def test_a_bomb_of_macros_ends_at_its_time_with_all_that_it_started() -> None:
    double = "".join(
        f"#define A{i + 1} A{i} A{i} A{i} A{i} A{i} A{i} A{i} A{i}\n" for i in range(12)
    )
    name = f"bomb_{os.getpid()}.c"  # of no other test that runs beside this one
    result = compile_program(
        {name: HEAD + f"#define A0 1.0,\n{double}double y[] = {{A12}};\n"}, timeout_s=1.5
    )
    assert not result.ok
    here = {p.parent for p in Path("/proc").glob("[0-9]*/cmdline") if _is_compiling(p, name)}
    assert here == set()


def test_no_compiler_outlives_a_target_that_ends(tmp_path: Path) -> None:
    """Two of 1.3 GB each computed on, for up to 90 s, when a target had ended."""
    double = "".join(f"#define A{i + 1} {f'A{i} ' * 8}\n" for i in range(12))
    name = f"left_{os.getpid()}.c"
    (tmp_path / name).write_text(HEAD + f"#define A0 1.0,\n{double}double y[] = {{A12}};\n")
    code = (
        "import sys, threading\nfrom pathlib import Path\n"
        "from zendsp_target.__main__ import leave\n"
        "from zendsp_target.runtime.compile_service import compile_program\n"
        f"sources = {{{name!r}: Path({name!r}).read_text()}}\n"
        "threading.Thread(target=compile_program, args=[sources], daemon=True).start()\n"
        "sys.stdin.read()\nleave(0)"
    )

    def compiling() -> list[Path]:
        return [p for p in Path("/proc").glob("[0-9]*/cmdline") if _is_compiling(p, name)]

    with subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stdin=subprocess.PIPE) as it:
        until(lambda: bool(compiling()), "it compiles", compiling)
        assert it.stdin is not None
        it.stdin.close()
        assert it.wait(10.0) == 0
        ended = time.monotonic()
    until(lambda: not compiling(), "none is left", compiling)
    assert time.monotonic() - ended < 2.0, "it ended by itself, at its limit"


@pytest.mark.parametrize(
    ("work", "ok"),
    [("sleep 1.3", True), ("while :; do :; done", False), ("sleep 1000", False)],
    ids=["waits for a processor", "computes", "hangs"],
)
def test_a_compilation_that_is_given_little_of_a_processor_is_given_longer(
    work: str, ok: bool, tmp_path: Path
) -> None:
    ended = compiler._run(["sh", "-c", work], tmp_path, os.environ, 1.0)
    assert (ended.why == "") is ok
    assert ok or ended.why == "the compiler did not finish within 1 s and was stopped"


def _is_compiling(path: Path, name: str) -> bool:
    """Whether a process compiles the file; one that was killed and is not gone yet, on a busy
    computer, does not.
    """
    try:
        words = path.read_bytes()
        state = dict(
            line.split(":", 1) for line in (path.parent / "status").read_text().splitlines()
        )
        flags = int((path.parent / "stat").read_text().rpartition(")")[2].split()[6])
    except OSError:
        return False
    killed = (int(state["SigPnd"], 16) | int(state["ShdPnd"], 16)) >> (
        signal.SIGKILL - 1
    ) & 1 or flags & EXITING
    return name.encode() in words and b"cc1" in words and not killed


def test_a_bomb_of_memory_is_refused_its_memory() -> None:
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    eight = "".join(f"#define A{i + 1} A{i} A{i} A{i} A{i} A{i} A{i} A{i} A{i}\n" for i in range(4))
    # 3.5 GB within seconds
    string = f'#define A0 "{"x" * (900 << 10)}"\n{eight}const char y[] = A4;\n'
    result = compile_program({"much.c": HEAD + string})
    assert not result.ok
    assert "needs more than the 2048 MB" in result.diagnostics[-1].message
    most = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss
    assert most < 2_300_000 or most == before, "kB"


def test_a_bomb_of_messages_is_cut() -> None:
    # 500 bytes each
    lines = "".join(f"#warning {'w' * 200} {i}\n" for i in range(10_000))
    result = compile_program({"loud.c": HEAD + lines})
    assert not result.ok and len(result.diagnostics) == 1
    assert "wrote more than 4 MB of messages" in result.diagnostics[0].message


def test_of_many_messages_the_first_are_told() -> None:
    result = compile_program({"loud.c": HEAD + "".join(f"#warning w {i}\n" for i in range(1000))})
    assert [d.message.partition("w ")[2].split()[0] for d in result.diagnostics] == [
        str(i) for i in range(200)
    ]


def test_of_many_errors_the_first_are_told() -> None:
    """gcc that stops at so many errors says none of them."""
    result = compile_program({"x.c": HEAD + "".join(f"int a{i} = b{i};\n" for i in range(300))})
    assert not result.ok and len(result.diagnostics) == 200
    assert "'b0' undeclared" in result.diagnostics[0].message


def test_a_flag_that_keeps_the_compiler_from_making_a_program_is_an_error() -> None:
    result = compile_program({"x.c": HEAD}, flags=["-fsyntax-only"])
    assert ["made no program" in d.message for d in result.diagnostics] == [True]


def test_an_error_is_told_whatever_characters_it_quotes() -> None:
    result = compile_program({"x.c": HEAD + "#error a\x1b[2Jb\n"})
    assert ["#error a" in d.message for d in result.diagnostics] == [True]


def test_a_huge_result_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compiler, "_MAX_FILE", 1 << 20)  # far below every other limit
    result = compile_program({"huge.c": HEAD + "char y[8 << 20] = {1};\n"}, timeout_s=10.0)
    assert not result.ok
    assert "its result exceeds 1 MB" in result.diagnostics[0].message


@pytest.mark.parametrize(
    ("limit", "most", "said"),
    [
        ("_MAX_PROCESSES", 0, "more than 0 processes"),
        ("_MAX_MEMORY_ALL", 1 << 20, "took more than 1 MB"),
        ("_MAX_FOLDER", 10, "wrote files of more"),
    ],
)
def test_a_compilation_is_limited_as_a_whole(
    limit: str, most: int, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, limit, most)
    double = "".join(
        f"#define A{i + 1} A{i} A{i} A{i} A{i} A{i} A{i} A{i} A{i}\n" for i in range(12)
    )
    result = compile_program(
        {f"{limit.lower()}.c": HEAD + f"#define A0 1.0,\n{double}double y[] = {{A12}};\n"},
        timeout_s=20.0,
    )
    assert not result.ok and said in result.diagnostics[0].message, result.diagnostics


WAYS = {
    "include": '#include "{path}"\n',
    "angle": "#include <{path}>\n",
    "climb": '#include "../../../../../../../../../../../..{path}"\n',
    "macro": '#define P "{path}"\n#include P\n',
    "line": '#line 1 "{path}"\n#error here\n',
    "has_include": '#if __has_include("{path}")\n#error ' + SECRET + "\n#endif\n",
    "incbin": 'asm(".section .rodata\\n.global got\\ngot: .incbin \\"{path}\\"\\n.previous");\n',
    "escaped": (
        'asm(".section .rodata\\n.global got\\ngot: .inc\\142in \\"{path}\\"\\n.previous");\n'
    ),
    "assembler": 'asm(".include \\"{path}\\"");\n',
}


@needs_landlock
@pytest.mark.parametrize("way", list(WAYS))
def test_a_file_outside_is_never_shown(
    way: str, secret: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from zendsp_target.runtime.compile_service import program_path

    monkeypatch.setattr(compiler, "_ALONE", False)  # Landlock by itself
    result = compile_program({"peek.c": HEAD + WAYS[way].format(path=secret)})
    assert SECRET not in str(result.diagnostics)
    assert way == "has_include" or not result.ok
    if result.ok:
        assert SECRET.encode() not in program_path(result.key).read_bytes()


OTHER = """#!/bin/sh
[ "$1" = --version ] && exec echo clang version 14
shift  # what gcc does not take
[ "$(readlink /proc/self/exe)" = "$0" ] && exec gcc "$@"
"""


@needs_root_of_its_own
@pytest.mark.parametrize("way", ["include", "has_include"])
@pytest.mark.parametrize("folder", ["", "gcc", ".", "bin"])
def test_whether_a_file_outside_is_there_cannot_be_told(
    folder: str, way: str, secret: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nor by a compiler at home that looks for its headers beside what /proc/self/exe names, as
    clang and zig do.
    """
    if folder == "gcc":
        monkeypatch.setenv("CC", folder)
    elif folder:
        (stand_in := secret.parent / folder / "clang").parent.mkdir(exist_ok=True)
        stand_in.write_text(OTHER)
        stand_in.chmod(0o755)
        monkeypatch.setenv("CC", str(stand_in))
    assert compile_program({"plain.c": HEAD}).ok

    def told(path: Path) -> str:
        result = compile_program({"peek.c": HEAD + WAYS[way].format(path=path)})
        return f"{result.ok} {result.diagnostics}".replace(str(path), "path")

    assert told(secret) == told(secret.with_name("nobody"))


def test_a_message_about_a_file_outside_is_not_passed_on(secret: Path) -> None:
    """Nor where there is no Landlock: the compiler would quote the line at which it fails."""
    named = compile_program({"line.c": HEAD + f'#line 1 "{secret}"\n#error here\n'})
    assert not named.ok
    assert [d for d in named.diagnostics if str(secret) in d.file] == []


LACKS = Message("error", "user.c", 2, 1, "expected ';' before 'int'")


@pytest.mark.parametrize(
    "text",
    [80_000 * "\n", 400_000 * "/*", '"' + 400_000 * r"\"", 100_000 * "#include \"a\n"],
    ids=["blank lines", "comments", "quotes", "includes"],
)
def test_a_long_source_holds_up_nothing_while_it_is_looked_through(text: str) -> None:
    """The target read 10 MB of blank lines for hours, and heard no STOP over the link meanwhile."""
    began = time.monotonic()
    source = {"user.c": (text + "\nint x\n").encode()}
    assert build._included(source) == set()
    assert sources._INCLUDE.findall(text) == []
    where_it_lacks(LACKS, source)
    parse_messages(40_000 * "controlling expression type 'a' ")
    assert time.monotonic() - began < 2.0  # a tenth of that here; without care, 5 s and far more


def test_an_include_is_found_however_it_is_written() -> None:
    written = b'int a;\r\n \t# include\t"b.c" // and\n#include"c.c"\n// #include "d.c"\n'
    assert build._included({"user.c": written}) == {"b.c", "c.c"}


def test_variables_beyond_what_the_linker_reaches_are_told() -> None:
    result = compile_program({"user.c": HEAD + "char a[1UL << 33]; char *f(void) { return a; }"})
    assert "more than 2 GB" in " ".join(d.message for d in result.diagnostics)
