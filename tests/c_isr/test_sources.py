"""The C sources themselves: no warning, nothing in the sample that could block, one layout on both
sides.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from zendsp_isr.build import source_root
from zendsp_isr.compiler import find_compiler
from zendsp_isr.parts import build_machine, machine_names
from zendsp_isr.sources import gather
from zendsp_protocol.errors import CompileFailed
from zendsp_target.runtime.memory.layout import layout
from zendsp_target.runtime.safety import histogram_edges

ROOT = source_root()
STRICT = [
    "-std=gnu11", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Wstrict-prototypes",
    "-Werror",
]
INCLUDE = [f"-I{ROOT / folder}" for folder in ("include", "runtime", "machines")]
SOURCES = sorted(
    path for folder in ("runtime", "machines", "programs") for path in (ROOT / folder).glob("*.c")
)
# what a sample may call: the clock, copying bytes, mathematics that the compiler did not inline
MAY_CALL = {
    "clock_gettime", "clock_nanosleep", "memcpy", "memset", "memmove", "_GLOBAL_OFFSET_TABLE_",
}
OURS = ("batch_", "stream_", "safety_", "realtime_granted", "loop")
BETWEEN_RUNS = {"realtime_stay_awake"}  # at start and pause, not in a sample


def compile_(source: Path, folder: Path, *flags: str) -> Path:
    """Compile one file with all warnings that are asked for; returns the object."""
    made = folder / f"{source.stem}.o"
    command = [*find_compiler().command, *flags, *INCLUDE, "-c", str(source), "-o", str(made)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return made


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_source_compiles_without_a_warning(source: Path, tmp_path: Path) -> None:
    compile_(source, tmp_path, *STRICT)


@pytest.mark.parametrize(
    "header", ["include/isr.h", "include/machine.h", "include/machine_config.h", "runtime/layout.h"]
)
def test_every_public_header_stands_alone_and_is_pedantic_c11(header: str, tmp_path: Path) -> None:
    source = tmp_path / "x.c"
    source.write_text(f'#include "{ROOT / header}"\ntypedef int not_empty;\n')
    compile_(source, tmp_path, "-std=c11", "-Wpedantic", *STRICT[2:])


@pytest.mark.skipif(shutil.which("nm") is None, reason="needs nm")
def test_a_sample_calls_nothing_that_allocates_locks_prints_or_blocks(tmp_path: Path) -> None:
    undefined: set[str] = set()
    for name in ("loop", "batch", "stream", "safety"):
        target = compile_(ROOT / "runtime" / f"{name}.c", tmp_path, "-std=gnu11", "-O2")
        listed = subprocess.run(
            ["nm", "-u", str(target)], capture_output=True, text=True, check=True
        ).stdout
        undefined |= {line.split()[-1] for line in listed.splitlines() if line.strip()}
    foreign = {name for name in undefined if not name.startswith(OURS)} - MAY_CALL - BETWEEN_RUNS
    assert foreign == set()
    assert "clock_nanosleep" in undefined  # the list was really read


def test_monitor_and_runner_agree_on_the_layout(tmp_path: Path) -> None:
    ffi, _ = layout()
    names = (
        "control", "variable_entry", "stream_head", "batch", "batch_entry", "snapshot",
        "timing_counts", "machine_info",
    )
    source = tmp_path / "sizes.c"
    lines = "".join(f'    printf("%zu\\n", sizeof({name}));\n' for name in names)
    source.write_text(
        f'#include <stdio.h>\n#include "layout.h"\nint main(void) {{\n{lines}    return 0;\n}}\n'
    )
    program = tmp_path / "sizes"
    subprocess.run(
        [*find_compiler().command, *INCLUDE, str(source), "-o", str(program)], check=True
    )
    said = subprocess.run([str(program)], capture_output=True, text=True, check=True).stdout.split()
    assert [int(size) for size in said] == [ffi.sizeof(name) for name in names]


def test_histogram_bins_have_the_edges_that_are_published(tmp_path: Path) -> None:
    _, lib = layout()
    values = [0, 1, 3, 4, 5, 7, 8, 9, 10, 15, 16, 1000, 123_456, 10**9, 2**40]
    source = tmp_path / "bins.c"
    lines = "".join(f'    printf("%u\\n", timing_bin({value}ull));\n' for value in values)
    source.write_text(
        f'#define _GNU_SOURCE\n#include <stdio.h>\n#include "timing.h"\nint main(void) {{\n'
        f"{lines}    return 0;\n}}\n"
    )
    program = tmp_path / "bins"
    subprocess.run(
        [*find_compiler().command, "-O1", *INCLUDE, str(source), "-o", str(program)], check=True
    )
    bins = [
        int(b)
        for b in subprocess.run(
            [str(program)], capture_output=True, text=True, check=True
        ).stdout.split()
    ]
    edges = histogram_edges(int(lib.LAYOUT_BINS))
    assert np.all(np.diff(edges) > 0)
    for value, b in zip(values, bins, strict=True):
        assert edges[b] <= value < edges[b + 1] or (b == len(edges) - 2 and value >= edges[b])


def test_every_shipped_machine_builds_and_an_unknown_one_is_named() -> None:
    for name in machine_names():
        assert build_machine(name).exists()
    with pytest.raises(CompileFailed, match="imi_planar"):
        build_machine("no_such_machine")


def test_a_shipped_header_comes_along_with_a_program_of_another_folder(tmp_path: Path) -> None:
    """Who begins with a copy of pd.c need not find and copy what it includes."""
    text = '#include "isr.h"\n#include "motion.h"\n#include "x/motion.h"\n'
    (tmp_path / "mine.c").write_text(text)
    shipped = (ROOT / "programs" / "motion.h").read_text()
    assert gather(tmp_path / "mine.c")["motion.h"] == shipped
    (tmp_path / "motion.h").write_text("/* mine */")
    assert gather(tmp_path / "mine.c")["motion.h"] == "/* mine */"
    assert set(gather(tmp_path / "mine.c")) == {"mine.c", "motion.h"}
    assert gather({"mine.c": text}) == {"mine.c": text, "motion.h": shipped}
    both = {"mine.c": text, "motion.h": "/* mine */"}
    assert gather(both) == both


def test_the_text_of_a_program_is_not_taken_for_its_path() -> None:
    with pytest.raises(CompileFailed, match="text of a program where a path is expected"):
        gather('#include "isr.h"\nvoid UserInit(void) {}\n')


@pytest.mark.parametrize(
    ("read", "words"),
    [
        (b"// one\n// Verst\xe4rkung\n", "line 2: the byte 0xe4 is no UTF-8 text: save the file"),
        ("// one\n".encode("utf-16"), "mine.c: is no UTF-8 text: give a C file, saved as UTF-8"),
    ],
)
def test_a_source_in_another_encoding_is_refused_with_its_line_and_what_to_do(
    read: bytes, words: str, tmp_path: Path
) -> None:
    (tmp_path / "mine.c").write_bytes(read)
    with pytest.raises(CompileFailed, match=words):
        gather(tmp_path / "mine.c")


def test_a_source_with_the_ends_of_lines_of_windows_is_taken(tmp_path: Path) -> None:
    (tmp_path / "mine.c").write_bytes(b"// one\r\n// two\r\n")
    assert gather(tmp_path / "mine.c") == {"mine.c": "// one\n// two\n"}
