"""The proof as a page: what was measured, by which command, on which day, including what fails."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime

from zendsp.proof.judge import Judgement
from zendsp.proof.scoreboard import failures, headline, reliability, table_of


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def beside(ours: Sequence[Judgement], peers: Mapping[str, Sequence[Judgement]]) -> list[list[str]]:
    """Headline rows of every method on the same cases, one column each."""
    columns = [headline(ours), *(headline(j) for j in peers.values())]
    return [[row[0].strip(), row[2], *(c[i][1] for c in columns)] for i, row in enumerate(columns[0])]


def proof_page(
    ours: Sequence[Judgement],
    peers: Mapping[str, Sequence[Judgement]],
    *,
    command: str,
    stamp: str,
    notes: Sequence[str] = (),
) -> str:
    """``proof.md`` as text."""
    day = datetime.now(UTC).strftime("%Y-%m-%d")
    lines = [
        "# Proof",
        "",
        f"Measured on {day} by `{command}` on {platform.machine()}, Python {platform.python_version()}.",
        f"{len(ours)} cases, simulated by code that shares nothing with the diagnosis. The truth was sealed before the first",
        f"diagnosis ran; SHA-256 of the list of seals: `{stamp}`.",
        "",
        "## Scoreboard",
        "",
        *markdown_table(["", "wanted", "zendsp", *peers], beside(ours, peers)),
        *[f"- {note}" for note in notes],
        "",
        "A method is right when it names the concealed effect first on the right joint, when its first finding's set of names",
        "that it cannot tell apart holds it, or when the recording itself cannot tell the two apart (by algebra, or measured by",
        "an oracle that sees the true motion). Detectable: the best refit of the incomplete model leaves at least 60 of",
        "log-likelihood in the innovations of a steady observer.",
        "",
        "## By effect and size",
        "",
    ]
    sizes = sorted({j.size for j in ours if j.named is not None}, reverse=True)
    lines += markdown_table(
        ["effect", *(f"x{s:g}" for s in sizes)], table_of(ours, lambda j: j.effects[0], sizes)
    )
    lines += ["## By machine and kind of concealment", ""]
    rows = table_of(ours, lambda j: f"{j.machine}, {j.kind}", sizes)
    lines += markdown_table(["machine, kind", *(f"x{s:g}" for s in sizes)], rows)
    lines += ["## Stated confidence against hit rate", ""]
    bins = [[f"{a:.2f} to {b:.2f}", str(n), f"{s:.3f}", f"{h:.3f}"] for a, b, n, s, h in reliability(ours)]
    lines += markdown_table(["stated", "findings", "mean stated", "right"], bins)
    wrong = failures(ours)
    lines += [
        "## What fails",
        "",
        *(f"- {line}" for line in wrong),
        *([] if wrong else ["Nothing in this run."]),
        "",
    ]
    return "\n".join(lines)
