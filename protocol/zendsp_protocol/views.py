"""What a notebook shows of an object: sentences, tables and curves as HTML and SVG that load
nothing from elsewhere; and tables for a prompt.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from math import ceil, floor, inf, isfinite, log10
from typing import Any

from zendsp_protocol.values import Packed, from_wire

COLOURS = ("#1f5fa8", "#b4451f", "#3a7d44", "#8a6d00", "#7a4fa0", "#2987a8", "#a23b78", "#555555")
WIDTH, HEIGHT, LEFT, RIGHT = 640, 200, 64, 8  # pixels
LANE = 110  # pixels; of each where there are several
MOST = 8  # curves
ELEMENTS = 8  # of an array's value
DIGITS = 7  # of a measured number, at the most: a smaller uncertainty is a formal one
NOTHING = 1e-30  # smaller, in any unit of a machine, is what a filter that dies away leaves


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


def text_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table as a terminal shows it, numbers to the right.

    Examples
    --------
    >>> print(text_table(["NAME", "N"], [["q", "12"], ["tau", "3"]]))
    NAME   N
    q     12
    tau    3
    """
    cells = [header, *rows]
    widths = [max(len(row[k]) for row in cells) for k in range(len(header))]
    right = [bool(rows) and all(_looks_numeric(row[k]) for row in rows) for k in range(len(header))]
    lines = []
    for row in cells:
        parts = [
            c.rjust(w) if r else c.ljust(w) for c, w, r in zip(row, widths, right, strict=True)
        ]
        lines.append("  ".join(parts).rstrip())
    return "\n".join(lines)


def _looks_numeric(text: str) -> bool:
    return text[:1] in "0123456789-+.–" and text not in ("-", "")


def short(value: Any) -> str:
    """The value of a variable as text; a dash where it is missing.

    Examples
    --------
    >>> short(0.1 + 0.2), short(float("nan")), short([1.0, -1e-56]), short(None)
    ('0.3', 'NaN', '[1, 0]', '–')
    """
    if isinstance(value, Packed):
        value = from_wire(value)
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        inner = ", ".join(short(item) for item in value[:ELEMENTS])
        return f"[{inner}{', …' if len(value) > ELEMENTS else ''}]"
    if value is None:
        return "–"
    if isinstance(value, float) and value != value:
        return "NaN"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.6g}" if abs(value) >= NOTHING else "0"
    return str(value)


def with_std(value: float, std: float, unit: str = "") -> str:
    """A number with its standard deviation, which has two digits; the number has as many decimals.
    Four digits where the deviation is not known.

    Examples
    --------
    >>> with_std(1.281, 0.3, "N m"), with_std(12051.2, 113.0), with_std(-3e-7, 2e-8, "1")
    ('1.28 ± 0.30 N m', '12050 ± 110', '(-3.00 ± 0.20)e-07')
    """
    unit = "" if unit in ("", "1") else f" {unit}"
    if not 0.0 < std < inf or not isfinite(value):
        return f"{value:z.4g}{unit}"
    last = floor(log10(float(f"{std:.1e}"))) - 1  # place of the last digit: -2 of 0.01
    first = floor(log10(max(abs(value), std)))
    if first - last >= DIGITS:
        return f"{value:z.{DIGITS}g} ± {std:.1e}{unit}"
    if -5 < first < DIGITS - 1:
        places = max(0, -last)
        value, std = round(value, -last), round(std, -last)
        return f"{value:z.{places}f} ± {std:.{places}f}{unit}"
    value, std, places = value / 10.0**first, std / 10.0**first, first - last
    return f"({value:z.{places}f} ± {std:.{places}f})e{first:+03}{unit}"


def curves(
    x: Sequence[float],
    columns: Sequence[tuple[str, Sequence[float]]],
    xlabel: str = "t [s]",
    log: bool = False,
) -> str:
    """Return curves over a common axis as SVG, a lane for each unit and size; at most eight curves.

    Parameters
    ----------
    x : sequence of float
        Increasing.
    columns : sequence of (name, values)
        Each as long as ``x``; what is not finite is a gap. A name may end in its unit, ``q [rad]``.
    log : bool
        Whether ``x``, positive, is drawn by its logarithm.

    Examples
    --------
    >>> curves([0.0, 1.0], [("q [rad]", [0.0, 2.0])]).count("<polyline")
    1
    """
    left_out, columns = len(columns) - MOST, columns[:MOST]
    lanes = _lanes(columns)
    if len(x) < 2 or not lanes:
        return sentence("no samples yet")
    at = [log10(v) for v in x] if log else x
    tall = HEIGHT if len(lanes) == 1 else LANE
    parts = []
    for number, chosen in enumerate(lanes):
        parts.append(f'<g transform="translate(0 {tall * number})">')
        parts.append(_lane(at, {k: columns[k][1] for k in chosen}, tall))
        parts.append("</g>")
    bottom = tall * len(lanes)
    scale = (WIDTH - LEFT - RIGHT) / ((at[-1] - at[0]) or 1.0)
    marks = _decades(x[0], x[-1]) if log else ticks(x[0], x[-1])
    for value in marks:
        place = LEFT + scale * ((log10(value) if log else value) - at[0])
        parts.append(_line(place, bottom - 4, place, bottom) + _text(place, bottom + 12, value))
    parts.append(_text(LEFT + (WIDTH - LEFT - RIGHT) / 2, bottom + 28, xlabel))
    legend = " ".join(
        f'<span style="color:{COLOURS[k]}">▬ {escape(name)}</span>'
        for k, (name, _) in enumerate(columns)
    ) + (f" and {left_out} more" if left_out > 0 else "")
    return (
        f'<div>{legend}</div><svg viewBox="0 0 {WIDTH} {bottom + 34}" width="{WIDTH}"'
        f' height="{bottom + 34}" xmlns="http://www.w3.org/2000/svg">{"".join(parts)}</svg>'
    )


def _lanes(columns: Sequence[tuple[str, Sequence[float]]]) -> list[list[int]]:
    """The numbers of the curves of each lane: they have one unit, and none a tenth of the range of
    another.
    """
    lanes: list[tuple[str, float, list[int]]] = []
    for k, (name, y) in enumerate(columns):
        finite = [v for v in y if v - v == 0.0]
        if not finite:
            continue
        unit, wide = name.rpartition(" [")[2] if " [" in name else "", max(finite) - min(finite)
        for other, width, chosen in lanes:
            if unit == other and 0.1 * width <= wide <= 10.0 * width:
                chosen.append(k)
                break
        else:
            lanes.append((unit, wide, [k]))
    return [chosen for _, _, chosen in lanes]


def _lane(x: Sequence[float], columns: dict[int, Sequence[float]], height: float) -> str:
    """Curves of one unit in their frame; the keys are the numbers of their colours."""
    finite = [v for y in columns.values() for v in y if v - v == 0.0]
    low, high = min(finite), max(finite)
    if high == low:
        low, high = low - (abs(low) or 1.0), high + (abs(high) or 1.0)
    wide, tall = WIDTH - LEFT - RIGHT, height - 12
    across, up = wide / ((x[-1] - x[0]) or 1.0), tall / (high - low)
    parts = [f'<rect x="{LEFT}" y="8" width="{wide}" height="{tall}" fill="none" stroke="#bbb"/>']
    for value in ticks(low, high):
        y = 8 + up * (high - value)
        parts.append(_line(LEFT, y, WIDTH - RIGHT, y) + _text(LEFT - 4, y + 4, value, "end"))
    for k, values in columns.items():
        for run in _runs(x, values):
            points = " ".join(
                f"{LEFT + across * (a - x[0]):.1f},{8 + up * (high - b):.1f}" for a, b in run
            )
            parts.append(f'<polyline points="{points}" fill="none" stroke="{COLOURS[k]}"/>')
    return "".join(parts)


def ticks(low: float, high: float) -> list[float]:
    """Return two to six round numbers between two numbers.

    Examples
    --------
    >>> ticks(-0.0098, 0.0126)
    [-0.005, 0.0, 0.005, 0.01]
    """
    decade = floor(log10((high - low) / 5)) if high > low else 0
    step = next(
        (m * 10.0**decade for m in (1, 2, 5) if (high - low) <= 5 * m * 10.0**decade),
        10.0 ** (decade + 1),
    )
    return [float(f"{k * step:.12g}") for k in range(ceil(low / step), floor(high / step) + 1)]


def _decades(low: float, high: float) -> list[float]:
    """Marks of a logarithmic axis."""
    first, last = floor(log10(low)), ceil(log10(high))
    numbers = [float(f"{m}e{d}") for d in range(first, last + 1) for m in (1, 2, 5)]
    return [v for v in numbers if low <= v <= high]


def _line(x1: float, y1: float, x2: float, y2: float) -> str:
    return f'<path d="M{x1:.1f} {y1:.1f}L{x2:.1f} {y2:.1f}" stroke="#bbb" stroke-width="0.5"/>'


def _text(x: float, y: float, words: float | str, anchor: str = "middle") -> str:
    shown = words if isinstance(words, str) else f"{words:.10g}"
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" font-size="11"'
        f' fill="currentColor">{escape(shown)}</text>'
    )


def _runs(x: Sequence[float], y: Sequence[float]) -> list[list[tuple[float, float]]]:
    """The parts of a curve without a gap."""
    runs: list[list[tuple[float, float]]] = [[]]
    for a, b in zip(x, y, strict=True):
        if b - b == 0.0:
            runs[-1].append((a, b))
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]
