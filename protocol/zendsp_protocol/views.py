"""What a notebook shows of an object: sentences, tables and curves as HTML and SVG that need
nothing from elsewhere.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

COLOURS = ("#1f5fa8", "#b4451f", "#3a7d44", "#8a6d00", "#7a4fa0", "#2987a8", "#a23b78", "#555555")
WIDTH, HEIGHT, LEFT, BOTTOM = 640, 200, 64, 22  # pixels
MOST = 8  # curves


def sentence(text: str) -> str:
    """Return a paragraph.

    Examples
    --------
    >>> sentence("q < 2 rad")
    '<p>q &lt; 2 rad</p>'
    """
    return f"<p>{escape(text)}</p>"


def html_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table.

    Examples
    --------
    >>> html_table(["a"], [[1]])
    '<table><tr><th>a</th></tr><tr><td>1</td></tr></table>'
    """
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>" for row in rows
    )
    return f"<table><tr>{head}</tr>{body}</table>"


def curves(
    x: Sequence[float], columns: Sequence[tuple[str, Sequence[float]]], xlabel: str = "t [s]"
) -> str:
    """Return curves over a common axis as SVG; at most eight.

    Parameters
    ----------
    x : sequence of float
        Increasing.
    columns : sequence of (name, values)
        Each as long as ``x``; what is not finite is a gap.
    xlabel : str

    Examples
    --------
    >>> curves([0.0, 1.0], [("q [rad]", [0.0, 2.0])]).count("<polyline")
    1
    """
    columns = columns[:MOST]
    finite = [v for _, y in columns for v in y if v - v == 0.0]
    if len(x) < 2 or not finite:
        return sentence("no samples yet")
    low, high = min(finite), max(finite)
    if high == low:
        low, high = low - 1.0, high + 1.0
    wide, tall = WIDTH - LEFT - 8, HEIGHT - BOTTOM - 8
    span = (x[-1] - x[0]) or 1.0
    parts = []
    for k, (_, y) in enumerate(columns):
        for run in _runs(x, y):
            points = " ".join(
                f"{LEFT + wide * (a - x[0]) / span:.1f},{8 + tall * (high - b) / (high - low):.1f}"
                for a, b in run
            )
            colour = COLOURS[k]
            parts.append(f'<polyline points="{points}" fill="none" stroke="{colour}"/>')
    legend = " ".join(
        f'<span style="color:{COLOURS[k]}">▬ {escape(name)}</span>'
        for k, (name, _) in enumerate(columns)
    )
    frame = f'<rect x="{LEFT}" y="8" width="{wide}" height="{tall}" fill="none" stroke="#bbb"/>'
    texts = (
        (LEFT - 4, 16, "end", f"{high:.4g}"),
        (LEFT - 4, 8 + tall, "end", f"{low:.4g}"),
        (LEFT, HEIGHT - 6, "start", f"{x[0]:.4g}"),
        (WIDTH - 8, HEIGHT - 6, "end", f"{x[-1]:.4g}"),
        (LEFT + wide // 2, HEIGHT - 6, "middle", xlabel),
    )
    labels = "".join(
        f'<text x="{a}" y="{b}" text-anchor="{anchor}" font-size="11" fill="currentColor">'
        f"{escape(text)}</text>"
        for a, b, anchor, text in texts
    )
    return (
        f'<div>{legend}</div><svg viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}"'
        f' height="{HEIGHT}" xmlns="http://www.w3.org/2000/svg">'
        f"{frame}{''.join(parts)}{labels}</svg>"
    )


def _runs(x: Sequence[float], y: Sequence[float]) -> list[list[tuple[float, float]]]:
    """Stretches without a gap."""
    runs: list[list[tuple[float, float]]] = [[]]
    for a, b in zip(x, y, strict=True):
        if b - b == 0.0:
            runs[-1].append((a, b))
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]
