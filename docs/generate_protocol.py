"""Write the tables of ``docs/protocol.md`` from the code: every verb, and every field with the
comment beside it.

python docs/generate_protocol.py          # rewrite the file
"""

from __future__ import annotations

import inspect
import re
import textwrap
from enum import StrEnum
from pathlib import Path

import msgspec

from zendsp_protocol import messages, verbs

FILE = Path(__file__).parent / "protocol.md"
BEGIN, END = "<!-- generated: {} -->", "<!-- end -->"


def kind(annotation: object) -> str:
    """Write a type as a reader of any language understands it."""
    if isinstance(annotation, type):
        text = "str" if issubclass(annotation, str) else annotation.__name__
    else:
        text = re.sub(r"zendsp_protocol\.messages\.\w+\.", "", str(annotation))
    for old, new in (
        ("zendsp_protocol.verbs.", ""),
        ("zendsp_protocol.values.", ""),
        ("typing.", ""),
        ("bool | int | float | list[bool | int | float] | Packed", "value"),
        (", ...]", "]"),
        (" | ", " or "),
    ):
        text = text.replace(old, new)
    return re.sub(r"tuple\[", "list[", text)


def comments(struct: type) -> dict[str, str]:
    """Comments above or beside the fields of a struct, by name."""
    found: dict[str, str] = {}
    above: list[str] = []
    for line in inspect.getsource(struct).splitlines():
        code, _, comment = (part.strip() for part in line.partition("#"))
        if comment and not code:
            above.append(comment)
            continue
        field = re.match(r"(\w+):", code)
        if field:
            found[field[1]] = " ".join([*above, comment]).strip()
        above = []
    return found


def words(annotation: object) -> str:
    """The words that an argument may be, empty where it is no word of a few."""
    known = isinstance(annotation, type) and issubclass(annotation, StrEnum)
    return " \\| ".join(annotation) if known else ""


def default(field: msgspec.structs.FieldInfo) -> str:
    """Write the default of a field, empty where it is required."""
    if field.default is not msgspec.NODEFAULT:
        return repr(field.default).replace("'", '"').replace("None", "nil")
    return "" if field.default_factory is msgspec.NODEFAULT else "empty"


def verb_table() -> str:
    """One row for each verb, and one for each argument."""
    lines = ["| verb | does | role | lane | once | result | limit, s |", "|---" * 7 + "|"]
    rows: dict[type, list[str]] = {}
    for verb in verbs.VERBS.values():
        once, result = "✓" * verb.once, f"{kind(verb.result)} | {verb.timeout:g}"
        lines.append(
            f"| `{verb.name}` | {verb.does} | {verb.role} | {verb.lane} | {once} | {result} |"
        )
        rows.setdefault(verb.arguments, []).append(f"`{verb.name}`")
    lines += ["", "Their arguments; those with a default may be left out:", ""]
    lines += ["| verb | argument | type | default | meaning |", "|---" * 5 + "|"]
    for arguments, names in rows.items():
        said = comments(arguments)
        lines += [
            f"| {', '.join(names)} | `{f.name}` | {kind(f.type)} | {default(f)} |"
            f" {'; '.join(filter(None, (words(f.type), said.get(f.name, ''))))} |"
            for f in msgspec.structs.fields(arguments)
        ]
    return "\n".join(lines)


def structs() -> list[type[msgspec.Struct]]:
    """All messages, in the order of the source."""
    found = [
        item
        for module in (messages, verbs)
        for item in vars(module).values()
        if isinstance(item, type)
        and issubclass(item, messages.Message)
        and item is not messages.Message
    ]
    return sorted(
        dict.fromkeys(found), key=lambda item: (item.__module__, inspect.getsourcelines(item)[1])
    )


def message_tables() -> str:
    """A table for each message."""
    parts = []
    for struct in structs():
        said = comments(struct)
        summary = " ".join((inspect.getdoc(struct) or "").split())
        lines = [*textwrap.wrap(f"**{struct.__name__}** – {summary}", 100), ""]
        fields = msgspec.structs.fields(struct)
        if fields:
            lines += ["| field | type | meaning |", "|---|---|---|"]
            lines += [f"| `{f.name}` | {kind(f.type)} | {said.get(f.name, '')} |" for f in fields]
        parts.append("\n".join(lines).rstrip())
    return "\n\n".join(parts)


def updated(text: str) -> str:
    """Put the present tables between their marks."""
    for name, body in (("verbs", verb_table()), ("messages", message_tables())):
        mark = BEGIN.format(name)
        head, _, rest = text.partition(mark)
        _, _, tail = rest.partition(END)
        text = f"{head}{mark}\n\n{body}\n\n{END}{tail}"
    return text


if __name__ == "__main__":
    FILE.write_text(updated(FILE.read_text(encoding="utf-8")), encoding="utf-8")
