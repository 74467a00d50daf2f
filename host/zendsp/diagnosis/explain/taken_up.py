"""Where an arm takes a load up or puts it down within a recording. The recording is cut there, so
that its pieces are recordings of a machine with another load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis.data.prepare import prepare
from zendsp.diagnosis.data.signals import MIN_SAMPLES, Signals
from zendsp.diagnosis.decide.thresholds import PREDICTED
from zendsp.diagnosis.explain.other_bodies import pieces_of
from zendsp.diagnosis.search.body_columns import Layout, Sums
from zendsp.diagnosis.search.body_hypotheses import LIMITS, Hypothesis, hypotheses
from zendsp.diagnosis.search.body_solver import Solver
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]
Load = tuple[Hypothesis, Array]

STEP_S = 0.25  # a change is looked for at whole numbers of these
SHORTEST = 12  # of these: a load for a shorter time is a push
FAR_STEPS = 4  # of these, at first
# s, before and after a change, are cut out: a load hardly shows before it is moved. Found changes
# were up to 0.5 s off
AROUND_S = 0.5
NOTHING = Hypothesis("nothing")


def cut_where_taken(
    signals: Sequence[Sequence[Signals]], given: Model, jobs: int
) -> list[list[Signals]]:
    """The recordings of an arm (``signals``: to fit to, to choose by, to test on), cut where their
    load changes; the pieces are recordings of their own, named after their times. As given where it
    changes nowhere.
    """
    times = {name: _changes(own, given, jobs) for name, own in pieces_of(signals).items()}
    return [
        [piece for s in part for piece in _pieces(s, times[s.whole or s.name])]
        for part in signals
    ]


def _changes(pieces: Sequence[Signals], given: Model, jobs: int) -> list[float]:
    """The times at which the load of a recording changes, s."""
    loads = _Loads(pieces, given, jobs)
    ends, todo = [], [(0, len(loads.at))]
    while todo:
        begin, end = todo.pop()
        at = loads.change(begin, end)
        if at is not None:
            ends.append(at)
            todo += [(begin, at), (at, end)]
    return sorted(loads.at[k] for k in ends)


def _pieces(s: Signals, times: Sequence[float]) -> list[Signals]:
    """A recording, or a part of one, cut at some times."""
    if not times:
        return [s]
    name, out = s.whole or s.name, []
    for k, (begin, end) in enumerate(zip((-math.inf, *times), (*times, math.inf), strict=True)):
        words = f"from {begin:.4g} to {end:.4g} s"
        words = f"until {end:.4g} s" if k == 0 else words
        words = f"from {begin:.4g} s on" if k == len(times) else words
        first, last = np.searchsorted(s.time, (begin + AROUND_S, end - AROUND_S))
        if last - first >= MIN_SAMPLES:
            part = s.part(int(first), int(last), f"{name} {words}")
            out.append(replace(part, whole=part.name))
    return out


class _Loads:
    """What each load of an arm's ends, and none, cost on some steps of one recording."""

    def __init__(self, pieces: Sequence[Signals], given: Model, jobs: int) -> None:
        data = prepare(pieces, given, LIMITS.bandwidth)
        links = data.records[0][0].links
        assert links is not None
        ends = {k + 1 for k in range(len(links.bodies)) if all(b.parent != k for b in links.bodies)}
        every = hypotheses(given, links)
        self.loads = [h for h in every if h.effect == "payload" and h.joint in ends]
        self.layout = Layout(given, links)
        limits = replace(LIMITS, block=STEP_S, blocks=1)
        self.sums = Sums(data, given, limits, jobs, about=self.loads)
        rows = (max(10, round(STEP_S / rec[0].sample_time)) for rec in data.records)
        self.at = [float(t) for s, n in zip(pieces, rows, strict=True) for t in s.time[::n]]

    def _solver(self, begin: int, end: int) -> Solver:
        steps = np.arange(len(self.at))
        some = self.sums.some((begin <= steps) & (steps < end))
        return Solver(some, some, self.layout)

    def gains(self, begin: int, at: int, end: int) -> Array:
        """What loads of their own before and after a change gain over the likelier of one load in
        both and none: deviance a sample, (joints,). Friction is that of each either way.
        """
        both = [self._solver(begin, at), self._solver(at, end)]
        whole = self._solver(begin, end)
        one = [[load, load] for load in self._likeliest(whole)]
        left = min((_points(both, loads) for loads in one), key=_total)
        own = [min((_points([x], [a]) for a in self._likeliest(x)), key=_total) for x in both]
        counts = whole.fit.counts.sum(axis=1)
        return np.asarray((left - own[0] - own[1]) / np.maximum(counts, 1.0))

    def _likeliest(self, solver: Solver) -> list[Load]:
        return [(h, solver.estimate(h)) for h in (NOTHING, *self.loads)]

    def change(self, begin: int, end: int) -> int | None:
        """The step at which the load of these steps changes; None where that explains less than
        most of what one load leaves at one joint.
        """
        least, most = begin + SHORTEST, end - SHORTEST
        if most < least:
            return None
        found: dict[int, Array] = {}

        def best_of(steps: range) -> int:
            found.update((k, self.gains(begin, k, end)) for k in steps if k not in found)
            return max(found, key=lambda k: float(found[k].sum()))

        near = best_of(range(least, most + 1, FAR_STEPS))
        near = best_of(range(max(least, near - FAR_STEPS + 1), min(most, near + FAR_STEPS - 1) + 1))
        return near if float(found[near].sum()) > -math.log(1.0 - PREDICTED) else None


def _points(solvers: Sequence[Solver], loads: Sequence[Load]) -> Array:
    """The deviance of some steps with a load each, (joints,)."""
    each = zip(solvers, loads, strict=True)
    return np.asarray(sum(x.points(x.at(h, values)).sum(axis=1) for x, (h, values) in each))


def _total(deviances: Array) -> float:
    return float(deviances.sum())
