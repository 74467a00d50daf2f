"""The result of a sweep, and its best run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from zendsp.errors import AcquisitionError
from zendsp.experiment.table_file import write_rows
from zendsp_protocol.texts import counted
from zendsp_protocol.values import Assignable
from zendsp_protocol.views import html_table, sentence

# Times the range of three measurements: two others that are alike lie further apart once in twenty
# (Student's t of two degrees of freedom, 4.30 √2, over the mean range in standard deviations, 1.7).
APART = 3.6


@dataclass(frozen=True)
class SweepRun:
    """One run of a sweep; ``run["Kp1"]`` and ``run["rms e1"]`` are its values and results."""

    values: Mapping[str, Assignable]  # of the parameters that were tried
    results: Mapping[str, float] = field(default_factory=dict)  # none where it ended early
    ended: str = ""  # why the program stopped; "" where it ran

    def __getitem__(self, name: str) -> Assignable:
        return self.results[name] if name in self.results else self.values[name]

    def row(self) -> dict[str, Assignable]:
        """Values and results by the names of columns, for a file or JSON."""
        return {**self.values, **self.results, "ended": self.ended}


@dataclass(frozen=True, repr=False)
class Sweep:
    """The result of `sweep`.

    Attributes
    ----------
    parameters : tuple of str
    results : tuple of str
        Names of what was measured, for example ``"rms e1"``.
    rows : tuple of SweepRun
    again : tuple of dict
        The results of the best row's values, measured again after the last row: what chance does
        to a small error is small. Where the motion is periodic and a window does not last whole
        periods, they differ as much as the pieces of the motion do.
    ended : str
        What ended the program, in a run or when the parameters were put back; "" where it goes on.
    units : dict of str to str
        Of each parameter and result.
    planned : int
        Runs that were asked for: more than there are rows where the sweep ended early.
    again_of : int
        Row whose values were measured again.
    """

    parameters: tuple[str, ...]
    results: tuple[str, ...]
    rows: tuple[SweepRun, ...]
    again: tuple[Mapping[str, float], ...] = ()
    ended: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    planned: int = 0
    again_of: int = 0

    @property
    def header(self) -> list[str]:
        """The names of the columns of `cells`, with their units."""
        return [*(self._with_unit(n) for n in (*self.parameters, *self.results)), "ended"]

    def _with_unit(self, name: str) -> str:
        unit = self.units.get(name, "")
        return f"{name} [{unit}]" if unit else name

    def spread(self, result: str = "") -> float:
        """By how much a result differs where the same values are measured again; NaN where that is
        not known.

        Parameters
        ----------
        result : str
            Default: the first.
        """
        name = result or self.results[0]
        every = (self.rows[self.again_of].results, *self.again)
        found = [abs(results[name]) for results in every if name in results]
        return max(found) - min(found) if self.again else float("nan")

    def best_rows(self, result: str = "") -> list[int]:
        """The numbers of the rows that are as good as `best_row`, at a level of 5 %.

        Parameters
        ----------
        result : str
            Default: the first.
        """
        name, least = result or self.results[0], self.best_row(result)
        if least is None:
            return []
        spread = self.spread(name)
        most = abs(self.rows[least].results[name]) + (APART * spread if spread > 0.0 else 0.0)
        return [
            k
            for k, row in enumerate(self.rows)
            if k == least or (not row.ended and abs(row.results[name]) <= most)
        ]

    def best(self, result: str = "") -> SweepRun:
        """The run with the smallest result; `best_rows` has those that are as good.

        Parameters
        ----------
        result : str
            Default: the first.

        Raises
        ------
        AcquisitionError
            No such result, or no run came to its end.
        """
        name = result or self.results[0]
        if name not in self.results:
            raise AcquisitionError(f"no result {name!r}; there are {', '.join(self.results)}")
        k = self.best_row(name)
        if k is None:
            raise AcquisitionError("no run came to its end")
        return self.rows[k]

    def best_row(self, result: str = "") -> int | None:
        """The number of the row that `best` returns; None where no run was completed."""
        name = result or self.results[0]
        whole = [k for k, row in enumerate(self.rows) if not row.ended]
        return min(whole, key=lambda k: abs(self.rows[k].results[name]), default=None)

    def save(self, path: str | Path) -> Path:
        """Write the table as CSV.

        Raises
        ------
        RecordingError
            The name ends otherwise, or the file cannot be written.
        """
        header = [*self.parameters, *self.results, "ended"]
        return write_rows(path, "a sweep", header, (run.row() for run in self.rows))

    def cells(self) -> list[list[str]]:
        """The rows as text."""
        digits = {n: digits_of([row.values[n] for row in self.rows]) for n in self.parameters}
        return [
            [
                *(short(row.values[n], digits[n]) for n in self.parameters),
                *(short(row.results.get(n, "")) for n in self.results),
                row.ended,
            ]
            for row in self.rows
        ]

    def __repr__(self) -> str:
        end = f"; the program ended: {self.ended}"
        return f"<{self._found()}{end if self.ended else ''}>"

    def _found(self) -> str:
        """The result of the sweep in a sentence."""
        done = len(self.rows)
        some = f"{done} of " if done < self.planned else ""
        head = f"Sweep of {some}{counted(max(done, self.planned), 'run')}: "
        try:
            best = self.best()
        except AcquisitionError as error:
            return f"{head}{error}"
        cells = self.cells()[self.best_row() or 0]
        at = ", ".join(f"{n} = {cells[k]}" for k, n in enumerate(self.parameters))
        what, spread = self.results[0], self.spread()
        unit = f" {self.units[what]}" if self.units.get(what) else ""
        least = f"{short(best[what])}{unit}, at {at}"
        again = f"its values measured again differ by {short(spread, 2)}{unit}"
        if (alike := len(self.best_rows())) > 1:
            return (
                f"{head}none is best: {what} of the best {alike} differs by no more than chance"
                f". The least is {least}; {again}. Measure for longer, a periodic motion for whole"
                " periods"
            )
        return f"{head}{what} is least, {least}{f'; {again}' if spread == spread else ''}"  # NaN

    def _repr_html_(self) -> str:
        """What a notebook shows: the best run, and all of them."""
        return sentence(repr(self)[1:-1]) + html_table(self.header, self.cells())


def short(value: Any, digits: int = 5) -> str:
    """A value as text for a table."""
    return f"{value:.{digits}g}" if isinstance(value, float) else str(value)


def digits_of(values: Sequence[Any]) -> int:
    """The number of digits with which different values are written differently."""
    different = {v for v in values if isinstance(v, float)}
    enough = (n for n in range(5, 17) if len({f"{v:.{n}g}" for v in different}) == len(different))
    return next(enough, 17)
