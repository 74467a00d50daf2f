"""Compiling what the host sends: messages with the user's lines, limits, the cache, and refusals.
"""

from __future__ import annotations

import errno
import os
import tempfile
import time
from pathlib import Path
from typing import Any

import pytest

from zendsp_isr.build import build, cache_root, content_key
from zendsp_isr.compiler import find_compiler, run_compiler
from zendsp_isr.sources import gather
from zendsp_protocol.errors import CompileFailed, Refused
from zendsp_target.runtime import Runtime, program_text
from zendsp_target.runtime.compile_service import compile_program, program_path
from zendsp_target.runtime.process.settings import Settings, split_options

HEAD = '#include "isr.h"\nstatic double x;\nvoid UserInit(void) { SIGNAL(x, "", ""); }\n'


def test_a_program_without_the_header_is_told_so_and_nothing_else() -> None:
    """Four warnings and three errors of the linker had not named it."""
    source = 'static double q;\nvoid UserInit(void) { SIGNAL(q, "", ""); }\n'
    said = compile_program({"a.c": source + "void UserISR_INT2(void) { }\n"}).diagnostics
    assert [(d.line, 'include "isr.h"' in d.message) for d in said] == [(1, True)]


@pytest.mark.parametrize(
    ("end", "column"),
    [("", 21), ("  // of the angle", 21), (' /* of "it" */\n\n', 21)],
)
def test_a_semicolon_that_lacks_after_a_macro_is_told_of_the_line_where_it_lacks(
    end: str, column: int
) -> None:
    # gcc names the next word, and that may be an internal name in another line
    source = f"""#include "isr.h"
static double q, r;
void UserInit(void) {{
SIGNAL(q, "rad", ""){end}
SIGNAL(r, "rad", "");
}}
void UserISR_INT2(void) {{ q = 1.0; Acquire() }}
void UserBackground(void) {{}}
"""
    said = compile_program({"pd.c": source}).diagnostics
    assert [(d.line, d.column, d.message) for d in said if d.severity == "error"] == [
        (4, column, "expected ';' at the end of this line"),
        (7 + end.count("\n"), 45, "expected ';'"),
    ]


def test_an_error_names_file_line_and_column() -> None:
    result = compile_program({"law.c": HEAD + "void UserISR_INT2(void) {\n    x = 1.0\n}\n"})
    assert not result.ok
    first = next(d for d in result.diagnostics if d.severity == "error")
    assert (first.file, first.line) == ("law.c", 5)
    assert first.column > 4
    assert "expected" in first.message
    with pytest.raises(Refused, match="compile it first"):
        program_path(result.key)


def test_a_warning_does_not_stop_and_is_kept_with_the_cached_result() -> None:
    source = {"law.c": HEAD + f"void UserISR_INT2(void) {{\n    int unused_{time.time_ns()};\n}}\n"}
    fresh, again = compile_program(source), compile_program(source)
    assert fresh.ok and again.ok
    assert (fresh.cached, again.cached) == (False, True)
    assert [(d.severity, d.line) for d in fresh.diagnostics] == [("warning", 5)]
    assert again.diagnostics == fresh.diagnostics
    assert again.key == fresh.key


def test_several_files_and_headers_make_one_program() -> None:
    sources = {
        "main.c": HEAD + '#include "gains.h"\nvoid UserISR_INT2(void) { x = law(GAIN); }\n',
        "law.c": (
            '#include "isr.h"\n#include "gains.h"\n'
            "double law(double u) { return u * SAMPLE_PERIOD; }\n"
        ),
        "gains.h": "#define GAIN 2.0\ndouble law(double u);\n",
    }
    assert compile_program(sources).ok
    broken = {**sources, "gains.h": "#define GAIN oops\ndouble law(double u);\n"}
    result = compile_program(broken)
    assert not result.ok
    assert {d.file for d in result.diagnostics if d.severity in ("error", "note")} & {
        "gains.h", "main.c",
    }


@pytest.mark.parametrize(
    ("source", "says"),
    [
        ('#include "isr.h"\nvoid UserInit(void) {}\n', "lacks UserISR_INT2"),
        ("void UserInit(void) {}\nvoid UserISR_INT2(void) {}\n", 'does not include "isr.h"'),
        (
            HEAD + "extern double missing(void);\nvoid UserISR_INT2(void) { x = missing(); }\n",
            "undefined reference",
        ),
        (
            HEAD
            + "static long l;\nvoid UserISR_INT2(void) { (void)l; }\n"
            + 'void f(void) { SIGNAL(l, "", ""); }\n',
            "take double, float, int32_t, bool, and arrays of them, no 'long int'",
        ),
        (
            HEAD
            + "static float k[2][3][4];\nvoid UserISR_INT2(void) { (void)k; }\n"
            + 'void f(void) { SIGNAL(k, "", ""); }\n',
            "arrays of them, of one or two dimensions: this one has more",
        ),
        (
            HEAD
            + "static double *k;\nvoid UserISR_INT2(void) { (void)k; }\n"
            + 'void f(void) { SIGNAL(k, "", ""); }\n',
            "a pointer is no variable: declare the array itself",
        ),
        (
            HEAD + "static double q[JOINTS];\nvoid UserISR_INT2(void) { q[0] = 1.0; }\n",
            "write 'static double q[8];', and declare SIGNAL_FIRST(q, JOINTS, unit, text)",
        ),
        (
            HEAD + "void UserISR_INT2(void) { static double qd[JOINTS]; qd[0] = 1.0; }\n",
            "write 'static double qd[8];', and declare SIGNAL_FIRST(qd, JOINTS, unit, text)",
        ),
    ],
)
def test_a_program_that_cannot_run_is_a_compile_error(source: str, says: str) -> None:
    result = compile_program({"user.c": source})
    assert not result.ok
    assert says in " ".join(d.message for d in result.diagnostics)


def test_compiling_runs_nothing_of_the_program(tmp_path: Path) -> None:
    witness = tmp_path / "witness"
    source = HEAD + "#include <fcntl.h>\nvoid UserISR_INT2(void) {}\n"
    source += (
        f'__attribute__((constructor)) static void f(void) {{ open("{witness}", O_CREAT | O_WRONLY,'
        " 0600); }\n"
    )
    assert compile_program({"user.c": source}).ok
    assert not witness.exists()


def test_an_undefined_function_is_told_with_its_line() -> None:
    source = (
        HEAD + "extern double missing(void);\nvoid UserISR_INT2(void) {\n    x = missing();\n}\n"
    )
    errors = [d for d in compile_program({"user.c": source}).diagnostics if d.severity == "error"]
    assert ("user.c", 6) in [(d.file, d.line) for d in errors]


def test_a_compilation_without_end_is_stopped() -> None:
    # an include that never ends: the compiler waits on a terminal that is not there, or on itself
    deep = (
        "#define A(x) x x x x x x x x x x\n"
        "#define B(x) A(A(A(A(A(A(A(A(x))))))))\n"
        "static double y[] = { B(1.0,) };\n"
    )
    result = compile_program(
        {"user.c": HEAD + deep + "void UserISR_INT2(void) { x = y[0]; }\n"}, timeout_s=1.0
    )
    assert not result.ok
    assert result.diagnostics


def test_a_compilation_that_waits_for_a_pipe_is_stopped_when_its_time_is_over(
    tmp_path: Path,
) -> None:
    os.mkfifo(tmp_path / "x.h")
    (tmp_path / "a.c").write_text('#include "x.h"\n')
    limit = 4.0
    begun = time.monotonic()
    ended = run_compiler(find_compiler(), ["-c", "a.c"], tmp_path, timeout_s=limit)
    took = time.monotonic() - begun
    assert not ended.ok and "did not finish within 4 s" in ended.messages[0].message
    # a second without wanting a processor; three times the limit is for those that do
    assert limit < took < 2.0 * limit


@pytest.mark.parametrize("name", ["../evil.c", "a/b.c", "/etc/x.c", "x.py", "-o.c", ""])
def test_names_that_reach_outside_are_refused(name: str) -> None:
    with pytest.raises(Refused):
        compile_program({name: "", "ok.c": program_text("template")})


@pytest.mark.parametrize(
    "flag",
    [
        "-fplugin=x.so", "-o/tmp/x", "@file", "-Wl,-x", "-Wp,-x", "-include/etc/passwd", "-B.",
        "x.c", "-I/etc",
    ],
)
def test_flags_that_reach_outside_are_refused(flag: str) -> None:
    with pytest.raises(Refused, match="not accepted"):
        compile_program({"ok.c": program_text("template")}, [flag])


def test_flags_are_part_of_the_key_and_reach_the_compiler() -> None:
    source = {
        "law.c": (
            HEAD + "#ifndef MODE\n#error no MODE\n#endif\nvoid UserISR_INT2(void) { x = MODE; }\n"
        )
    }
    assert not compile_program(source).ok
    one, two = compile_program(source, ["-DMODE=1"]), compile_program(source, ["-DMODE=2", "-O3"])
    assert one.ok and two.ok and one.key != two.key


def test_the_key_depends_on_everything_that_goes_in() -> None:
    base = ("program", {"a.c": b"1"}, {"isr.h": b"2"}, ["-O2"])
    keys = {
        content_key(*base),
        content_key("machine", *base[1:]),
        content_key(base[0], {"a.c": b"x"}, *base[2:]),
        content_key(base[0], {"b.c": b"1"}, *base[2:]),
        content_key(base[0], base[1], {"isr.h": b"x"}, base[3]),
        content_key(*base[:3], ["-O3"]),
    }
    assert len(keys) == 6


def test_the_compile_cache_keeps_used_programs_and_drops_the_oldest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENDSP_CACHE", str(tmp_path))
    monkeypatch.setattr("zendsp_isr.build._KEPT", 2)
    sources = [{"law.c": HEAD + f"void UserISR_INT2(void) {{ x = {i}.0; }}\n"} for i in range(5)]
    keys = []
    for age, source in enumerate(sources):
        keys.append(compile_program(source).key)
        os.utime(tmp_path / "program" / f"{keys[-1]}.so", (1000.0 + age, 1000.0 + age))
    assert not compile_program(sources[0]).cached
    assert compile_program(sources[4]).cached
    assert len(list((tmp_path / "program").glob("*.so"))) <= 3


def test_a_name_that_the_c_library_has_too_is_the_programs_own() -> None:
    # one object for all programs of the process would be the library's function, written upon
    source = """#include "isr.h"
double error, wait;
void pause(void) { wait += 2.0; }
void UserInit(void) { PARAMETER(error, 1.0, "", 0.0, 5.0, ""); SIGNAL(wait, "", ""); }
void UserISR_INT2(void) { error += 1.0; pause(); }
"""
    with Runtime("imi_planar", clock="fast") as runtime:
        result = runtime.compile({"user.c": source})
        runtime.load(result.key)
        runtime.start(ticks=3)
        runtime.wait_paused()
        assert runtime.read(["error", "wait"])[1] == {"error": 4.0, "wait": 6.0}


def test_a_program_made_for_another_header_is_refused_at_load() -> None:
    result = compile_program({"old.c": HEAD + "void UserISR_INT2(void) { x = 7.0; }\n"})
    old = program_path(result.key).read_bytes()
    source = (
        "const int zendsp_isr_abi = 99; void *zendsp; void UserInit(void) {} void"
        " UserISR_INT2(void) {}\n"
    )
    other = build("program", {"other.c": source.encode()}, [])
    assert other.path is not None and other.path.read_bytes() != old
    with (
        Runtime("imi_planar", clock="fast") as runtime,
        pytest.raises(Refused, match=r"another isr\.h"),
    ):
        runtime.load(other.key)


def test_options_of_the_runtime_are_read_from_text_and_wrong_ones_are_named() -> None:
    assert split_options({"realtime": "no", "spin_us": "5", "cpu": 1, "machine.q1": "0.5"}) == (
        {"realtime": False, "spin_us": 5.0, "cpu": 1},
        {"q1": "0.5"},
    )
    for options, says in (
        ({"spin": "5"}, "spin_us"),
        ({"cpu": "first"}, "a number"),
        ({"realtime": "maybe"}, "true or false"),
    ):
        with pytest.raises(Refused, match=says):
            split_options(options)
    for settings, says in (
        ({"rate_hz": 0.0}, "rate"),
        ({"clock": "slow"}, "clock"),
        ({"priority": 0}, "priority"),
        ({"memory_mb": float("inf")}, "MB for user code"),
        ({"speed": float("nan")}, "speed"),
        ({"hang_s": float("nan")}, "hang_s"),
        ({"load_s": 0.0}, "load_s"),
    ):
        with pytest.raises(Refused, match=says):
            Settings("imi_planar", {}, **settings)  # type: ignore[arg-type]


def test_a_clock_jump_does_not_remove_the_folder_of_a_running_compilation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A computer without a battery gets the time from the network, years later in one step."""
    monkeypatch.setenv("ZENDSP_CACHE", str(tmp_path))
    other = '#include "isr.h"\nvoid UserInit(void) {}\nvoid UserISR_INT2(void) {}\n/* %d */\n'
    left = tmp_path / "program" / "build-left"

    def slow(*arguments: Any) -> Any:
        monkeypatch.setattr("zendsp_isr.build.run_compiler", run_compiler)
        left.mkdir()
        now = time.time()
        monkeypatch.setattr(time, "time", lambda: now + 1e8)
        assert compile_program({"b.c": other % 2}).ok
        return run_compiler(*arguments)

    monkeypatch.setattr("zendsp_isr.build.run_compiler", slow)
    assert compile_program({"a.c": other % 1}).ok
    assert not left.exists(), "what a compiler that was killed left behind goes"


@pytest.mark.parametrize("way", ["open to others", "a link"])
def test_compiled_code_is_kept_in_no_folder_that_others_may_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, way: str
) -> None:
    """Programs found there are run, and another user could have put them there."""
    monkeypatch.setenv("ZENDSP_CACHE", "/dev/null/no-folder")
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    root = tmp_path / f"zendsp-{os.getuid()}"
    assert cache_root() == root
    assert cache_root() == root, "the second time as well"
    if way == "a link":
        root.rename(tmp_path / "elsewhere")
        root.symlink_to(tmp_path / "elsewhere")
    else:
        root.chmod(0o777)
    with pytest.raises(CompileFailed, match="set ZENDSP_CACHE to a folder of your own"):
        cache_root()


def test_a_full_disk_is_told_with_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZENDSP_CACHE", str(tmp_path))
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def write(*_: object) -> int:
        raise full

    monkeypatch.setattr(Path, "write_bytes", write)
    with pytest.raises(CompileFailed, match=f"{tmp_path}/program .No space left on device"):
        build("program", {"user.c": b"int x;"}, [])


def test_a_c_file_that_another_includes_is_compiled_within_it(tmp_path: Path) -> None:
    (tmp_path / "law.c").write_text("double law(double q) { return -5.0 * q; }\n")
    (tmp_path / "main.c").write_text(
        HEAD + '#include "law.c"\nvoid UserISR_INT2(void) { x = law(x); }\n'
    )
    result = compile_program(gather(tmp_path / "main.c"))
    assert result.ok and not result.diagnostics, result.diagnostics
