"""Reads a compiler's messages, with file, line and column."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

from zendsp_protocol.states import Severity
from zendsp_protocol.texts import placed

_TEXT = re.compile(
    r"^(?P<file>[^\s:][^:\n]*):(?P<line>\d+):(?:(?P<column>\d+):)?\s*"
    r"(?:(?P<severity>fatal error|error|warning|note):\s*)?(?P<message>.+)$"
)
# of inline assembly; without a line, or of the file in between, where it stands for no line of C
_ASSEMBLER = re.compile(
    r"^(?P<file>[^\s:][^:\n]*):(?:(?P<line>\d+):)?\s*"
    r"(?P<severity>Fatal error|Error|Warning): (?P<message>.+)$"
)
_BETWEEN = ".s"
# what gcc and clang say of a declaration by isr.h of another type
_NO_TYPE = re.compile(
    r"(?:'_Generic' selector of|controlling expression) type '([^']+?)(?: \*)?'.*not compatible"
)
_TYPES = "PARAMETER and SIGNAL take double, float, int32_t, bool, and arrays of them, {}"
# what gcc and clang say of a static array whose length is JOINTS
_NO_LENGTH = re.compile(
    r"variably modified '(?P<outer>\w+)' at file|storage size of '(?P<inner>\w+)' isn't constant"
    r"|variable length array declaration (?:not allowed at file|cannot have 'static')"
)
_DEEP = "(*)["  # in the type of a row of three dimensions or more

_SEMICOLON = "expected ';'"
# what is not closed goes on to its end: to look for that from each mark anew takes for ever
_COMMENT = re.compile(
    r"""("(?:\\.|[^"\\\n])*"?|'(?:\\.|[^'\\\n])*'?)|/\*.*?(?:\*/|\Z)|//[^\n]*""", re.DOTALL
)
_LONGEST = 1 << 20  # bytes of a source in which places are looked for
_QUOTED = 1000  # characters of a message, in which our own words for it are looked for
_TAB = 8  # columns, as gcc counts


@dataclass(frozen=True)
class Message:
    """One diagnostic: file, line and column from 1 (0 where unknown)."""

    severity: Severity
    file: str
    line: int
    column: int
    message: str

    def __str__(self) -> str:
        return placed(self.file, self.line, self.column, f"{self.severity}: {self.message}")


def parse_messages(text: str) -> tuple[Message, ...]:
    """Diagnostics from a compiler's standard error: gcc's JSON, the common ``file:line:column:
    severity: text``, and what an assembler says of ``asm("…")``.

    Returns
    -------
    tuple of Message
        In the order given, repetitions left out.

    Examples
    --------
    >>> parse_messages("pd.c:3:5: error: expected ';'")
    (Message(severity='error', file='pd.c', line=3, column=5, message="expected ';'"),)
    """
    found: list[Message] = []
    decoder = json.JSONDecoder(strict=False)  # gcc quotes what it was given as it is
    for line in text.splitlines():
        if line.startswith("["):
            try:
                entries, _ = decoder.raw_decode(line)
            except (json.JSONDecodeError, RecursionError):
                entries = None
            if isinstance(entries, list):
                found += [
                    message
                    for entry in entries
                    if isinstance(entry, dict)
                    for message in _from_json(entry)
                ]
                continue
        match = _TEXT.match(line)
        if match and (
            match["severity"]
            or "undefined" in match["message"]
            or "multiple definition" in match["message"]
        ):
            found.append(
                Message(
                    Severity(match["severity"] or "error"),
                    match["file"],
                    int(match["line"]),
                    int(match["column"] or 0),
                    match["message"],
                )
            )
        elif match := _ASSEMBLER.match(line):
            severity = Severity(match["severity"].lower())
            found.append(
                Message(severity, match["file"], int(match["line"] or 0), 0, match["message"])
            )
    return tuple(dict.fromkeys(_in_our_words(message) for message in found))


def between(message: Message) -> bool:
    """Whether a message of the assembler is about the intermediate file of the compiler, which the
    user never sees.
    """
    return message.file.endswith(_BETWEEN)


def without_between(message: Message) -> Message:
    """Such a message without the name of that file."""
    if not between(message):
        return message
    return replace(message, file="", line=0, message=f"in an asm statement: {message.message}")


def _in_our_words(message: Message) -> Message:
    text = message.message[:_QUOTED]
    if length := _NO_LENGTH.search(text):
        name = length["outer"] or length["inner"] or "q"
        return replace(
            message,
            message=f"the length of '{name}' is no constant, as JOINTS is the machine's: write"
            f" 'static double {name}[8];', and declare SIGNAL_FIRST({name}, JOINTS, unit, text)",
        )
    found = _NO_TYPE.search(text)
    if found is None:
        return message
    deep = "of one or two dimensions: this one has more"
    return replace(
        message, message=_TYPES.format(deep if _DEEP in found[1] else f"no '{found[1]}'")
    )


def where_it_lacks(message: Message, sources: Mapping[str, bytes]) -> Message:
    """A message about a missing semicolon, with the place where it belongs: after a macro gcc names
    the next word, perhaps on another line, perhaps within isr.h.
    """
    source = sources.get(message.file, b"")
    if not message.message.startswith(_SEMICOLON) or not 0 < len(source) <= _LONGEST:
        return message
    lines = source.decode(errors="replace").expandtabs(_TAB).split("\n")
    if not 0 < message.line <= len(lines):  # of a #line of the user's
        return message
    before = [*lines[: message.line - 1], lines[message.line - 1][: message.column - 1]]
    code = _COMMENT.sub(lambda found: found[1] or _blank(found[0]), "\n".join(before))
    line, column = code.rstrip().count("\n") + 1, len(code.rstrip().rpartition("\n")[2]) + 1
    if (line, column) == (message.line, message.column):
        return message
    text = _SEMICOLON + (" at the end of this line" if line < message.line else "")
    return replace(message, line=line, column=column, message=text)


def _blank(text: str) -> str:
    return "\n".join(" " * len(line) for line in text.split("\n"))


def _from_json(entry: dict[str, object]) -> list[Message]:
    severity = Severity(str(entry.get("kind", "error")))
    locations = entry.get("locations")
    file, line, column = "", 0, 0
    if isinstance(locations, list) and locations and isinstance(locations[0], dict):
        caret = locations[0].get("caret")
        if isinstance(caret, dict):
            file = str(caret.get("file", ""))
            line = int(caret.get("line", 0))
            column = max(int(caret.get("column", 0)), 0)  # gcc says -1 of none
    option = entry.get("option")
    text = str(entry.get("message", "")) + (f" [{option}]" if option else "")
    messages = [Message(severity, file, line, column, text)]
    children = entry.get("children")
    if isinstance(children, list):
        for child in children:
            if isinstance(child, dict):
                messages += _from_json(child)
    return messages
