"""``zendsp stats``: the timing of the loop."""

from __future__ import annotations

from typing import Any

import click
import numpy as np

from zendsp.cli.common import emit, open_target, target_options

WIDTH = 40  # of the longest bar


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
            "state": status.state,
            "rate_hz": status.rate_hz,
            "scheduling": status.scheduling,
            "timing": timing,
        }
        emit(body, as_json, lambda: _text(status, timing))


def _text(status: Any, timing: dict[str, Any]) -> str:
    period_us = 1e6 / status.rate_hz
    lines = [
        f"{status.state} at {status.rate_hz:g} Hz (period {period_us:g} µs), {status.clock} clock",
        status.scheduling,
        f"samples    {timing['ticks']}, overruns {timing['overruns']}, missed {timing['missed']}",
        _summary("execution", timing["exec_mean_ns"], timing["exec_max_ns"], period_us),
        _summary("lateness ", timing["late_mean_ns"], timing["late_max_ns"], period_us),
    ]
    edges = np.asarray(timing["histogram_edges_ns"], dtype=float) / 1e3
    for name in ("exec", "late"):
        counts = np.asarray(timing[f"{name}_histogram"])
        if counts.ndim == 1 and len(edges) == len(counts) + 1 and counts.sum():
            lines += [
                "",
                f"{'execution' if name == 'exec' else 'lateness'}, µs",
                *_bars(counts, edges),
            ]
    return "\n".join(lines)


def _summary(name: str, mean_ns: float, max_ns: float, period_us: float) -> str:
    share = 100.0 * mean_ns / 1e3 / period_us
    return (
        f"{name}  mean {mean_ns / 1e3:.2f} µs ({share:.2f} % of the period), max"
        f" {max_ns / 1e3:.2f} µs"
    )


def _bars(counts: np.ndarray[Any, Any], edges: np.ndarray[Any, Any]) -> list[str]:
    """One line per bin that holds anything; the length of the bar is the logarithm of the count."""
    used = np.flatnonzero(counts)
    top = np.log1p(counts.max())
    bars = [round(WIDTH * np.log1p(count) / top) for count in counts]
    return [
        f"{_short(edges[k])} … {_short(edges[k + 1])}  {counts[k]:10d} "
        f" {'█' * max(min(1, counts[k]), bars[k])}".rstrip()
        for k in range(used[0], used[-1] + 1)
    ]


def _short(edge: float) -> str:
    return f"{edge:9.3g}" if edge < 1000.0 else f"{edge:9.0f}"
