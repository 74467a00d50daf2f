"""The questions that a begun model file asks, each on a line of its own, until the line is gone."""

from __future__ import annotations

from pathlib import Path

from zendsp.physics.files.shipped import find_model
from zendsp_protocol.texts import counted, shown

ASKS = "# ? "  # begins the line of a question
TOLD = 2  # so many of them are told
LONGEST = 90  # characters that are told of one


def open_questions(path: str | Path) -> tuple[str, ...]:
    """The questions in a model file, in its order.

    Parameters
    ----------
    path : str or Path
        A model file, or the name of one that comes with zendsp. One that cannot be read asks none:
        what is wrong with it is told where its model is read.
    """
    try:
        text = find_model(path).read_text(encoding="utf-8")
    except (OSError, ValueError):
        return ()
    lines = map(str.strip, text.splitlines())
    return tuple(line.removeprefix(ASKS).strip() for line in lines if line.startswith(ASKS))


def still_open(path: str | Path) -> str:
    """A sentence on the questions that are open in a model file; empty where there is none."""
    asked = open_questions(path)
    if not asked:
        return ""
    told = [q if len(q) <= LONGEST else f"{q[:LONGEST]}…" for q in asked[:TOLD]]
    more = len(asked) - len(told)
    last = f"; and {more} more" if more else ""
    return (
        f"{Path(path).name}: {counted(len(asked), 'question')} open in it (answer them, and delete"
        f" their lines, {ASKS.strip()!r}): {shown('; '.join(told), lines=False)}{last}"
    )
