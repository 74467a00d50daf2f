"""The messages of compilers, assemblers and linkers."""

from __future__ import annotations

import pytest

from zendsp_isr.compiler import find_compiler
from zendsp_isr.messages import parse_messages
from zendsp_protocol.errors import CompileFailed
from zendsp_protocol.states import Severity
from zendsp_target.runtime.compile_service import compile_program

HEAD = '#include "isr.h"\nstatic double x;\nvoid UserInit(void) { SIGNAL(x, "", ""); }\n'


def test_a_compiler_that_does_not_run_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(CompileFailed, match="no-such-compiler"):
        find_compiler()


def test_messages_of_clang_are_read_from_text() -> None:
    text = (
        "law.c:3:5: error: use of undeclared identifier 'y'\n"
        "    y = 1;\n"
        "    ^\n"
        "law.c:9:2: warning: unused [-Wx]\n"
        "law.c:9:9: fatal error: 'x.h' file not found\n"
        "1 error generated.\n"
    )
    assert [(m.severity, m.file, m.line, m.column) for m in parse_messages(text)] == [
        ("error", "law.c", 3, 5),
        ("warning", "law.c", 9, 2),
        ("error", "law.c", 9, 9),
    ]


def test_a_gcc_message_of_unimplemented_code_is_an_error() -> None:
    (said,) = parse_messages('[{"kind": "sorry, unimplemented", "message": "no", "children": []}]')
    assert said.severity is Severity.ERROR


@pytest.mark.parametrize(
    ("asm", "said"),
    [
        ("foo %eax", ("user.c", 5, "no such instruction: `foo %eax'")),
        ("nop\\n\\tbar", ("user.c", 6, "no such instruction: `bar'")),
        ("1: jmp 2f", ("", 0, "in an asm statement: local label")),
    ],
)
def test_assembler_errors_are_reported(asm: str, said: tuple[str, int, str]) -> None:
    """They carry the user's line or none, never that of an intermediate file."""
    body = f'void UserISR_INT2(void) {{\n    asm("{asm}");\n}}\n'
    result = compile_program({"user.c": HEAD + body})
    first = result.diagnostics[0]
    assert not result.ok and len(result.diagnostics) == 1, result.diagnostics
    assert (first.severity, first.file, first.line) == ("error", *said[:2])
    assert first.message.startswith(said[2])


def test_what_the_assembler_says_of_a_file_outside_is_not_passed_on() -> None:
    """An assembler directive may include any file, whose lines would then be quoted."""
    forged = '\\n# 3 \\"/etc/passwd\\"\\nfoo\\n'
    body = f'asm("{forged}");\nvoid UserISR_INT2(void) {{}}\n'
    result = compile_program({"user.c": HEAD + body})
    assert [(d.file, d.message) for d in result.diagnostics] == [
        ("", "the compiler ended with status 1")
    ]


def test_the_linker_names_no_folder_of_the_target() -> None:
    law = "double law(double q) { return -5.0 * q; }\n"
    main = HEAD + law + "void UserISR_INT2(void) { x = law(x); }\n"
    result = compile_program({"main.c": main, "law.c": law})
    said = [d.message for d in result.diagnostics]
    assert any("multiple definition" in text for text in said), said
    assert "/" not in "".join(said).replace("././", "").replace("./", ""), said
