"""The proof as a page: what was measured, by which command, on which day, including what fails."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from textwrap import fill

from zendsp.proof.judge import Judgement
from zendsp.proof.scoreboard import by_given, by_reality, failures, headline, reliability, table_of

WIDTH = 100  # columns of the page's prose
JUDGED = (
    "What the rows count: [how an answer is judged](prove.md#how-an-answer-is-judged). Of the"
    " mechanism and the law only what is detectable counts: the best refit of the incomplete model"
    " leaves at least 60 of log-likelihood in the innovations, the errors of prediction, of a"
    " steady observer."
)
SIZES = (
    "The law first, of how many; x1, x0.3, … are the [sizes](prove.md#realities) of what is"
    " concealed."
)


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return [*lines, *("| " + " | ".join(row) + " |" for row in rows), ""]


def beside(ours: Sequence[Judgement], peers: Mapping[str, Sequence[Judgement]]) -> list[list[str]]:
    """Headline rows of every method on the same cases, one column each; ours for each reality
    apart.
    """
    columns = [headline(j) for j in (*parts(ours).values(), *peers.values())]
    return [
        [row[0].strip(), row[2], *(c[i][1] for c in columns)] for i, row in enumerate(columns[0])
    ]


def parts(ours: Sequence[Judgement]) -> dict[str, Sequence[Judgement]]:
    """Our columns: one, or one for each reality."""
    groups = by_reality(ours)
    return (
        {"zendsp": ours}
        if len(groups) < 2
        else {f"zendsp, {name}": group for name, group in groups.items()}
    )


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
        fill(
            f"Measured on {day} by `{command}` on {platform.machine()}, Python"
            f" {platform.python_version()}. {len(ours)} cases, simulated by code that shares"
            " nothing with the diagnosis. The truth was sealed before the first diagnosis ran;"
            f" SHA-256 of the list of seals: `{stamp}`.",
            WIDTH,
        ),
        "",
        "## Scoreboard",
        "",
        *markdown_table(["", "wanted", *parts(ours), *peers], beside(ours, peers)),
        *[fill(f"- {note}", WIDTH, subsequent_indent="  ") for note in notes],
        "",
        fill(JUDGED, WIDTH, break_on_hyphens=False),
        "",
        "## By effect and size",
        "",
        fill(SIZES, WIDTH),
        "",
    ]
    sizes = sorted({j.size for j in ours if j.named is not None}, reverse=True)
    lines += markdown_table(
        ["effect", *(f"x{s:g}" for s in sizes)], table_of(ours, lambda j: j.effects[0], sizes)
    )
    lines += ["## By machine and kind of concealment", ""]
    rows = table_of(ours, lambda j: f"{j.machine}, {j.kind}", sizes)
    lines += markdown_table(["machine, kind", *(f"x{s:g}" for s in sizes)], rows)
    if forms := by_given(ours):
        lines += ["## Given as URDF and as MJCF", ""]
        lines += markdown_table(["", "cases", "mechanism first", "law first"], forms)
    lines += ["## Stated confidence against hit rate", ""]
    for name, group in parts(ours).items():
        rows = [
            [f"{a:.1f} to {b:.1f}", str(n), f"{s:.3f}", f"{h:.3f}"]
            for a, b, n, s, h in reliability(group)
        ]
        lines += markdown_table([f"stated ({name})", "findings", "mean stated", "right"], rows)
    wrong = failures(ours)
    lines += [
        "## What fails",
        "",
        *(fill(f"- {line}", 100, subsequent_indent="  ") for line in wrong),
        *([] if wrong else ["Nothing in this run."]),
        "",
    ]
    return "\n".join(lines)
