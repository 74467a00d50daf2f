"""``zendsp stats``: the timing of the loop."""

from __future__ import annotations

from typing import Any

import click
import numpy as np

from zendsp.cli.common import emit, open_target, target_options
from zendsp_protocol import messages as m
from zendsp_protocol.texts import counted
from zendsp_protocol.values import from_wire

WIDTH = 40  # of the longest bar
MOST_LINES = 18  # both pictures and what stands above them are a screenful


@click.command("stats")
@target_options
def command(target: str, connect: str | None, as_json: bool) -> None:
    """Show lateness and execution time of the loop, overruns and missed samples.

    Example:  zendsp stats -t imi
    """
    from zendsp.link.variables import plain

    with open_target(target, connect) as t:
        status = t.status()
        timing = {n: plain(getattr(status.timing, n)) for n in status.timing.__struct_fields__}
        body = {
            "state": status.state, "rate_hz": status.rate_hz, "scheduling": status.scheduling,
            "timing": timing,
        }
        emit(body, as_json, lambda: _text(status))


def _text(status: m.Status) -> str:
    t, period_us = status.timing, 1e6 / status.rate_hz
    lines = [
        f"{status.state} at {status.rate_hz:g} Hz (period {period_us:g} µs), {status.clock} clock",
        status.scheduling,
        f"samples    {t.ticks}, overruns {t.overruns}, missed {t.missed}",
        _summary("execution", t.exec_mean_ns, t.exec_max_ns, period_us),
        _summary("lateness ", t.late_mean_ns, t.late_max_ns, period_us),
    ]
    edges = np.asarray(from_wire(t.histogram_edges_ns), dtype=float) / 1e3
    for name, binned in (("execution", t.exec_histogram), ("lateness", t.late_histogram)):
        counts = np.asarray(from_wire(binned))
        if counts.ndim == 1 and len(edges) == len(counts) + 1 and counts.sum():
            lines += ["", f"{name}, µs; bars: log of the samples", *bars(counts, edges)]
    return "\n".join(lines)


def late_since(before: m.Timing, now: m.Timing) -> str:
    """How many samples were late since ``before`` was read, and by how much, in words; "" where
    none was.
    """
    if now.ticks < before.ticks:  # another program was loaded
        before = m.Timing()
    if (count := now.overruns - before.overruns) <= 0:
        return ""
    binned = np.subtract(from_wire(now.late_histogram), from_wire(before.late_histogram))
    edge = np.asarray(from_wire(now.histogram_edges_ns))[int(np.flatnonzero(binned)[-1]) + 1]
    return f"{counted(count, 'sample')} late, by up to {1e-6 * min(edge, now.late_max_ns):.3g} ms"


def _summary(name: str, mean_ns: float, max_ns: float, period_us: float) -> str:
    share = 100.0 * mean_ns / 1e3 / period_us
    return (
        f"{name}  mean {mean_ns / 1e3:.2f} µs ({share:.2f} % of the period), max"
        f" {max_ns / 1e3:.2f} µs"
    )


def bars(counts: np.ndarray[Any, Any], edges: np.ndarray[Any, Any]) -> list[str]:
    """The lines of a histogram, one for each factor of two, or of four or more where that would be
    over 18 lines. The length of a bar is the logarithm of the count.
    """
    used = np.flatnonzero(counts)
    first, last = int(used[0]), int(used[-1])
    smallest = edges[edges > 0].min()
    octaves = np.round(np.log2(np.maximum(edges, smallest) / smallest), 6)
    span = 1
    while len(groups := np.unique(octaves[first : last + 1] // span)) > MOST_LINES:
        span *= 2
    lines = []
    for group in groups:
        bins = np.flatnonzero(octaves[:-1] // span == group)
        bins = bins[(bins >= first) & (bins <= last)]
        lines.append((edges[bins[0]], edges[bins[-1] + 1], int(counts[bins].sum())))
    top = np.log1p(max(count for _, _, count in lines))
    return [
        f"{_short(low)} … {_short(high)}  {count:10d} "
        f" {'█' * max(min(1, count), round(WIDTH * np.log1p(count) / top))}".rstrip()
        for low, high, count in lines
    ]


def _short(edge: float) -> str:
    return f"{edge:9.3g}" if edge < 1000.0 else f"{edge:9.0f}"
