"""A frequency response: gain and phase of each line, with their uncertainty."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from zendsp.experiment.table_file import write_rows
from zendsp.recording import Recording
from zendsp.recording.plot import save_figure
from zendsp_protocol.views import curves, html_table, sentence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
DB = 20.0 / math.log(10.0)  # dB of a small relative change
SURE = 0.9  # coherence below which a line is shown, and not believed
BENT_DB = 0.1  # distortion from which on the summary tells it


@dataclass(frozen=True, repr=False)
class FrequencyResponse:
    """The result of `frequency_response`.

    Attributes
    ----------
    f : ndarray, shape (n,)
        Excited frequencies, Hz.
    gain : ndarray of complex, shape (n,)
        Output over input, in ``unit``.
    std : ndarray, shape (n,)
        Standard deviation of ``gain``, in ``unit``: of what does not repeat, or ``distortion``
        where that is more.
    coherence : ndarray, shape (n,)
        0 … 1: the part of the power that repeats from period to period, of the weaker signal.
    distortion : ndarray, shape (n,)
        What friction, a gap or a limit adds in every period alike, in ``unit``. It holds at this
        amplitude; at another one the response is another.
    input, output : str
        Names of the signals.
    unit : str
        Empty where input and output have the same.
    periods : int
        That were used.
    recording : Recording
        Input and output, all of it; it carries the response with it, see `of`.
    """

    f: Floats
    gain: Complex
    std: Floats
    coherence: Floats
    distortion: Floats
    input: str
    output: str
    unit: str
    periods: int
    recording: Recording

    @property
    def magnitude_db(self) -> Floats:
        """Magnitude, 20 log10 |G|, dB."""
        return np.asarray(20.0 * np.log10(np.abs(self.gain)))

    @property
    def sure(self) -> npt.NDArray[np.bool_]:
        """Which lines can be trusted: those with a coherence of 0.9 or more."""
        return np.asarray(self.coherence >= SURE)

    @property
    def phase_deg(self) -> Floats:
        """Phase, deg, unwrapped from the lowest frequency up."""
        return np.asarray(np.degrees(np.unwrap(np.angle(self.gain))))

    def bandwidth(self) -> float:
        """The frequency at which the magnitude has fallen by 3 dB from its value at the lowest
        line, Hz; NaN where it has not.
        """
        level = self.magnitude_db - self.magnitude_db[0] + 3.0
        below = np.flatnonzero(level < 0.0)
        if len(below) == 0:
            return math.nan
        k = int(below[0])
        share = level[k - 1] / (level[k - 1] - level[k])
        return float(self.f[k - 1] * (self.f[k] / self.f[k - 1]) ** share)

    @classmethod
    def of(cls, recording: Recording) -> FrequencyResponse | None:
        """The response that a recording measured; None where the recording is of something else.

        Parameters
        ----------
        recording : Recording
            That a response has brought (``response.recording``), also out of a file.
        """
        kept = recording.extra.get("frequency_response")
        if kept is None:
            return None
        f, real, imaginary, std, coherence = (
            np.asarray(values, dtype=np.float64)
            for values in (
                kept["f"], kept["real"], kept["imaginary"], kept["std"], kept["coherence"]
            )
        )
        bent = np.asarray(kept.get("distortion", np.zeros_like(f)), dtype=np.float64)
        unit = "" if kept["unit"] == "1" else kept["unit"]  # of an older zendsp
        return cls(
            f, real + 1j * imaginary, std, coherence, bent, kept["input"], kept["output"], unit,
            kept["periods"], recording,
        )

    def rows(self) -> list[dict[str, float]]:
        """One row for each frequency: Hz, dB, deg, standard deviations, coherence."""
        spread = self.std / np.abs(self.gain)
        return [
            {
                "f": float(self.f[k]),
                "magnitude_db": float(self.magnitude_db[k]),
                "phase_deg": float(self.phase_deg[k]),
                "std_db": float(DB * spread[k]),
                "std_deg": float(np.degrees(spread[k])),
                "coherence": float(self.coherence[k]),
            }
            for k in range(len(self.f))
        ]

    def summary(self) -> str:
        """The response in one sentence."""
        unsure = int((~self.sure).sum())
        text = (
            f"{self.output} over {self.input}: {len(self.f)} frequencies from {self.f[0]:.3g} to"
            f" {self.f[-1]:.3g} Hz, {self.periods} periods"
        )
        k = int(np.argmax(self.magnitude_db))
        text += f"; highest {self.magnitude_db[k]:.1f} dB at {self.f[k]:.3g} Hz"
        if math.isfinite(width := self.bandwidth()):
            text += f", −3 dB at {width:.3g} Hz, from the value at {self.f[0]:.3g} Hz"
        text += f"; coherence below {SURE:g} at {unsure} line{'s' * (unsure > 1)}" if unsure else ""
        bent = DB * self.distortion / np.abs(self.gain)
        k = int(np.argmax(np.where(self.sure, bent, 0.0)))
        if self.sure[k] and bent[k] >= BENT_DB:
            text += (
                f"; not linear (dry friction, a gap, a limit): ± up to {bent[k]:.1f} dB. Another"
                " amplitude gives another response: measure with two"
            )
        return text

    def save(self, path: str | Path) -> Path:
        """Write the rows as CSV, for any tool.

        Raises
        ------
        RecordingError
            The name ends otherwise, or the file cannot be written.
        """
        rows = [{name: f"{v:.9g}" for name, v in row.items()} for row in self.rows()]
        return write_rows(path, "a frequency response", list(rows[0]), rows)

    def plot(self, path: str | Path | None = None) -> Figure:
        """Draw magnitude, phase and coherence over frequency.

        Parameters
        ----------
        path : path, optional
            Also write the figure there (PNG, SVG, PDF by suffix).
        """
        from matplotlib.ticker import LogLocator, NullFormatter

        from zendsp.recording.shown import ShownFigure

        figure = ShownFigure((7.0, 6.5), layout="constrained")
        axes = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1))
        spread = self.std / np.abs(self.gain)
        axes[0].errorbar(self.f, self.magnitude_db, DB * spread, fmt=".-", lw=1.0)
        axes[0].set_ylabel(f"magnitude [dB of {self.unit}]" if self.unit else "magnitude [dB]")
        axes[1].errorbar(self.f, self.phase_deg, np.degrees(spread), fmt=".-", lw=1.0)
        axes[1].set_ylabel("phase [deg]")
        axes[2].plot(self.f, self.coherence, ".-", lw=1.0)
        axes[2].axhline(SURE, color="#888888", lw=0.8, ls="--")
        axes[2].set(ylabel="coherence", xlabel="f [Hz]", ylim=(0.0, 1.05), xscale="log")
        # three numbers a decade: a response rarely spans more than two
        axes[2].xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes[2].xaxis.set_major_formatter("{x:g}")
        axes[2].xaxis.set_minor_formatter(NullFormatter())
        for axis in axes:
            axis.grid(True, which="both", alpha=0.3)
        figure.suptitle(
            f"{self.output} over {self.input}; bars: ± one standard deviation", fontsize=10
        )
        save_figure(figure, path)
        return figure

    def __repr__(self) -> str:
        return f"<FrequencyResponse {self.summary()}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: a sentence, magnitude and phase, the rows."""
        header = ("f [Hz]", "dB", "deg", "± dB", "± deg", "coherence")
        rows = shown_lines(self.rows())
        columns = [
            ("magnitude [dB]", self.magnitude_db.tolist()),
            ("phase [deg]", self.phase_deg.tolist()),
        ]
        drawn = curves(self.f.tolist(), columns, "f [Hz]", log=True)
        return sentence(self.summary()) + drawn + html_table(header, rows)


def shown_lines(rows: Sequence[Mapping[str, float]]) -> list[list[str]]:
    """The rows as text for a table."""
    digits = ("{:.3g}", "{:.2f}", "{:.1f}", "{:.2g}", "{:.2g}", "{:.3f}")
    return [[form.format(v) for form, v in zip(digits, row.values(), strict=True)] for row in rows]
