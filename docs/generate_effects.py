"""Write the table of effects in ``docs/diagnosis.md`` from the library.

python docs/generate_effects.py          # rewrite the file
"""

from __future__ import annotations

from pathlib import Path

from zendsp.physics.effects import Effect, library, unit_of

FILE = Path(__file__).parent / "diagnosis.md"
BEGIN, END = "<!-- generated: effects -->", "<!-- end -->"


def row(effect: Effect) -> str:
    """One line of the table: name, equation, parameters with their units on a rotary joint."""
    parts = []
    for parameter in effect.parameters:
        unit = unit_of(parameter.size, "rotary", "command")
        words = f"`{parameter.name}`" + (f" ({unit})" if unit != "1" else "")
        parts.append(words if parameter.default is None else f"[{words}]")
    equation = effect.equation.replace("|", "\\|")
    return f"| `{effect.name}` | {equation} | {', '.join(parts)} |"


def text() -> str:
    """The page with its table renewed."""
    page = FILE.read_text(encoding="utf-8")
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    lines = ["", "", "| name | equation | parameters |", "|---|---|---|", *(row(effect) for effect in library().values()), "", ""]
    return before + BEGIN + "\n".join(lines) + END + after


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8")
