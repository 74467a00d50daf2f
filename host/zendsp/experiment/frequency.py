"""Frequency response of a running machine: a multisine played from the program's own table, on the
target's own clock.

Estimator: the spectra of P whole periods of input u and output y, G = mean(Y) / mean(U) at each
excited line. Averages over periods tend to what the excitation causes. So G is right in a closed
loop too, where Y U* / U U* is not (Pintelon and Schoukens 2012, chapter 2). Coherence is the part
of both signals' power that repeats from period to period; the standard deviation of G comes from
what does not repeat.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from zendsp.errors import AcquisitionError, RecordingError
from zendsp.experiment.excite import play
from zendsp.experiment.table_file import write_rows
from zendsp.link import Target
from zendsp.prompt import shows_progress
from zendsp.recording import Recording
from zendsp.reference.crest import low_crest_phases
from zendsp_protocol.views import curves, html_table, sentence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]
KEPT = "frequency_response"  # where a recording carries it
SURE = 0.9  # coherence below which a line is shown, and not believed
REACH = 0.4  # of the sample rate: a line above is too near to half of it


@dataclass(frozen=True, repr=False)
class FrequencyResponse:
    """What `frequency_response` measured.

    Attributes
    ----------
    f : ndarray, shape (n,)
        Excited frequencies, Hz.
    gain : ndarray of complex, shape (n,)
        Output over input, in ``unit``.
    std : ndarray, shape (n,)
        Standard deviation of ``gain``, in ``unit``.
    coherence : ndarray, shape (n,)
        0 … 1: the part of the power that repeats from period to period, of the weaker signal.
    input, output, unit : str
    periods : int
    recording : Recording
        Input and output, all of it; it carries the response with it, see `of`.
    """

    f: Floats
    gain: Complex
    std: Floats
    coherence: Floats
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
        """Which lines are to be believed: those whose coherence is 0.9 or more."""
        return np.asarray(self.coherence >= SURE)

    @property
    def phase_deg(self) -> Floats:
        """Phase, deg, unwrapped from the lowest frequency up."""
        return np.asarray(np.degrees(np.unwrap(np.angle(self.gain))))

    def bandwidth(self) -> float:
        """Return the frequency at which the magnitude has fallen by 3 dB from its value at the
        lowest line, Hz; NaN where it has not.
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
        """Return the response that was measured by a recording; None where it is of something else.

        Parameters
        ----------
        recording : Recording
            That a response has brought (``response.recording``), also out of a file.
        """
        kept = recording.extra.get(KEPT)
        if not isinstance(kept, Mapping):
            return None
        f, real, imaginary, std, coherence = (
            np.asarray(kept[name], dtype=np.float64)
            for name in ("f", "real", "imaginary", "std", "coherence")
        )
        words = {name: str(kept[name]) for name in ("input", "output", "unit")}
        return cls(
            f, real + 1j * imaginary, std, coherence,
            periods=int(kept["periods"]), recording=recording, **words,
        )  # fmt: skip

    def rows(self) -> list[dict[str, float]]:
        """Return one row a frequency: Hz, dB, deg, standard deviations, coherence."""
        spread = self.std / np.abs(self.gain)
        return [
            {
                "f": float(self.f[k]),
                "magnitude_db": float(self.magnitude_db[k]),
                "phase_deg": float(self.phase_deg[k]),
                "std_db": float(20.0 / math.log(10.0) * spread[k]),
                "std_deg": float(np.degrees(spread[k])),
                "coherence": float(self.coherence[k]),
            }
            for k in range(len(self.f))
        ]

    def summary(self) -> str:
        """Return one sentence."""
        unsure = int((~self.sure).sum())
        text = (
            f"{self.output} over {self.input}: {len(self.f)} frequencies from {self.f[0]:.3g} to"
            f" {self.f[-1]:.3g} Hz, {self.periods} periods"
        )
        k = int(np.argmax(self.magnitude_db))
        text += f"; highest {self.magnitude_db[k]:.1f} dB at {self.f[k]:.3g} Hz"
        if math.isfinite(width := self.bandwidth()):
            text += f", −3 dB at {width:.3g} Hz"
        return f"{text}; coherence below {SURE:g} at {unsure}" if unsure else text

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
        from matplotlib.figure import Figure
        from matplotlib.ticker import LogLocator, NullFormatter

        figure = Figure((7.0, 6.5), layout="constrained")
        axes = figure.subplots(3, 1, sharex=True, height_ratios=(3, 3, 1))
        spread = self.std / np.abs(self.gain)
        axes[0].errorbar(self.f, self.magnitude_db, 2 * 8.686 * spread, fmt=".-", lw=1.0)
        pure = self.unit in ("", "1")
        axes[0].set_ylabel("magnitude [dB]" if pure else f"magnitude [dB of {self.unit}]")
        axes[1].errorbar(self.f, self.phase_deg, 2 * np.degrees(spread), fmt=".-", lw=1.0)
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
        figure.suptitle(f"{self.output} over {self.input}", fontsize=10)
        if path is not None:
            try:
                Path(path).parent.mkdir(parents=True, exist_ok=True)
                figure.savefig(path, dpi=120)
            except (OSError, ValueError) as error:
                raise RecordingError(f"{path}: cannot be written ({error})") from error
        return figure

    def __repr__(self) -> str:
        return f"<FrequencyResponse {self.summary()}>"

    def _repr_html_(self) -> str:
        """What a notebook shows: a sentence, magnitude and phase, the rows."""
        header = ("f [Hz]", "dB", "deg", "± dB", "± deg", "coherence")
        rows = [[f"{v:.4g}" for v in row.values()] for row in self.rows()]
        columns = [
            ("magnitude [dB]", self.magnitude_db.tolist()),
            ("phase [deg]", self.phase_deg.tolist()),
        ]
        drawn = curves(self.f.tolist(), columns, "f [Hz]", log=True)
        return sentence(self.summary()) + drawn + html_table(header, rows)


@shows_progress
def frequency_response(
    target: Target,
    *,
    joint: int = 1,
    f_min: float = 0.5,
    f_max: float = 30.0,
    lines: int = 30,
    amplitude: float = 0.02,
    quantity: Literal["position", "torque"] = "position",
    input: str = "",
    output: str = "",
    periods: int = 6,
    channels: Sequence[str] = (),
    rehearsed: bool = True,
    progress: Callable[[float], None] | None = None,
) -> FrequencyResponse:
    """Measure a frequency response with the loaded program, which follows its table ``ref``.

    One joint swings about where it stands by a multisine of low crest factor whose lines are
    multiples of ``f_min``, nearly evenly spaced in log f; the others are held. The first period is
    not used: what the beginning left dies away in it. A target on the fast clock is paused and
    starts with the recording; on the real clock the program goes on. Afterwards the machine is
    where it stood, and the program does what it did before: parameters and tables are put back.

    Parameters
    ----------
    target : Target
        With a program loaded that plays tables (docs/references.md): pd.c, joint_pd.c and others.
    joint : int
        From 1.
    f_min, f_max : float
        Hz. The period is 1 / ``f_min``.
    lines : int
        Frequencies at the most.
    amplitude : float
        Peak of the multisine, rad (m), or N m (N). Of a position, line k has amplitude ~ 1/k.
    quantity : {"position", "torque"}
        What swings: the reference ``ref``, or the torque ``ref_tau`` beside a position that is
        held.
    input, output : str
        Signals. Default: of a position the reference of the joint (``r``) and its position (``q``):
        the closed loop; of a torque the command (``tau``) and the position: the machine itself.
    periods : int
        That are used, at least 2; the standard deviation falls with the square root.
    channels : sequence of str
        What else the recording is to hold, for example what a diagnosis needs.
    rehearsed : bool
        Try it on a simulated twin first, where the clock is real.
    progress : callable, optional
        Called with the fraction done.

    Returns
    -------
    FrequencyResponse

    Raises
    ------
    Refused
        The program plays no tables, a limit would be or was passed, or nothing is loaded.
    AcquisitionError
        The band is impossible, a signal is unknown, or rows were lost.
    """
    infos = target.variables()
    given = input or _first(infos, joint, "r" if quantity == "position" else "tau")
    found = output or _first(infos, joint, "q")
    rate = target.info.rate_hz
    samples = round(rate / f_min)
    harmonics = choose_lines(samples, f_max / f_min, lines, rate)
    if periods < 2:
        raise AcquisitionError(f"periods = {periods}: at least 2, to tell what repeats")
    power = 1 if quantity == "position" else 0
    recording, first = play(
        target,
        lambda t: make_period(harmonics, amplitude, power, f_min, t),
        joint=joint,
        quantity=quantity,
        seconds=samples / rate,
        times=periods + 1,
        channels=[*channels, *(n for n in (given, found) if not _among(n, channels))],
        rehearsed=rehearsed,
        progress=progress,
    )
    u, y = (np.asarray(recording[name], dtype=np.float64) for name in (given, found))
    begin = first + samples  # the first period is left out
    if begin < 0 or begin + periods * samples > len(recording) or recording.lost:
        raise AcquisitionError(
            f"{recording.lost} rows were lost, or the recording began late: measure again"
        )
    used = slice(begin, begin + periods * samples)
    f = harmonics * rate / samples
    gain, std, coherence = estimate(u[used], y[used], periods, harmonics)
    units = {n: _unit(infos, n) for n in (given, found)}
    unit = f"{units[found] or '1'} / ({units[given] or '1'})"
    if units[found] == units[given]:
        unit = "1"
    kept = {
        "f": f, "real": gain.real, "imaginary": gain.imag, "std": std, "coherence": coherence,
    }  # fmt: skip
    words = {"input": given, "output": found, "unit": unit, "periods": periods}
    extra = {KEPT: {**{name: v.tolist() for name, v in kept.items()}, **words}}
    recording = replace(recording, extra={**recording.extra, **extra})
    return FrequencyResponse(
        f, gain, std, coherence, given, found, unit, periods, recording
    )  # fmt: skip


def choose_lines(samples: int, ratio: float, most: int, rate: float) -> npt.NDArray[np.int64]:
    """Return harmonics of a period, nearly evenly spaced in log f.

    Parameters
    ----------
    samples : int
        Of the period.
    ratio : float
        Highest over lowest frequency.
    most : int
        Number of harmonics.
    rate : float
        Of the samples, Hz.
    """
    if not (ratio > 1.0 and samples >= 4 and most >= 2):
        raise AcquisitionError(
            "the band is empty: f_min below f_max, both above 0, and at least two lines"
        )
    if ratio >= REACH * samples:
        raise AcquisitionError(
            f"f_max reaches {ratio * rate / samples:g} Hz; at {rate:g} Hz at most"
            f" {REACH * rate:g} Hz"
        )
    spaced = np.geomspace(1.0, math.floor(ratio + 1e-9), most)
    return np.unique(np.rint(spaced).astype(np.int64))


def make_period(
    harmonics: npt.NDArray[np.int64], amplitude: float, power: int, f_min: float, t: Floats
) -> Floats:
    """Return a multisine at times ``t`` (s) whose peak is ``amplitude``.

    Parameters
    ----------
    harmonics : ndarray of int
        Multiples of ``f_min``.
    power : int
        Line k has amplitude ~ k^-power.
    f_min : float
        Hz.
    """
    a = harmonics.astype(np.float64) ** -float(power)
    phases = low_crest_phases(harmonics, a)
    turns = np.outer(np.linspace(0.0, 1.0, 4096, endpoint=False), harmonics)
    peak = np.abs(np.cos(2 * np.pi * turns + phases) @ a).max()
    x = np.cos(2 * np.pi * np.outer(t * f_min, harmonics) + phases) @ a
    return np.asarray(amplitude / peak * x)


def estimate(
    u: Floats, y: Floats, periods: int, harmonics: npt.NDArray[np.int64]
) -> tuple[Complex, Floats, Floats]:
    """Return response, standard deviation and coherence at the harmonics.

    Parameters
    ----------
    u, y : ndarray, shape (periods * samples,)
        Whole periods of input and output.
    harmonics : ndarray of int, shape (n,)

    Returns
    -------
    gain : ndarray of complex, shape (n,)
    std, coherence : ndarray, shape (n,)
    """
    spectra = [np.fft.rfft(x.reshape(periods, -1), axis=1)[:, harmonics] for x in (u, y)]
    mean_u, mean_y = (s.mean(axis=0) for s in spectra)
    # what no encoder count resolves has no gain
    silent = np.abs(mean_u) <= 1e-12 * np.abs(spectra[0]).max()
    gain = np.where(silent, np.nan, mean_y / np.where(silent, 1.0, mean_u))
    left = (spectra[1] - gain * spectra[0]) / np.where(silent, 1.0, mean_u)
    std = np.sqrt((np.abs(left) ** 2).sum(axis=0) / (periods - 1) / periods)
    parts = [
        np.abs(s.mean(axis=0)) ** 2 / np.maximum((np.abs(s) ** 2).mean(axis=0), 1e-300)
        for s in spectra
    ]
    return gain, std, np.minimum(*parts)


def _among(name: str, channels: Sequence[str]) -> bool:
    return name in channels or name.partition("[")[0] in channels


def _first(infos: Mapping[str, Any], joint: int, name: str) -> str:
    """The signal of a joint: an array element, or a scalar with the joint's number."""
    if name in infos and infos[name].length >= joint:
        return f"{name}[{joint - 1}]" if infos[name].length > 1 else name
    if f"{name}{joint}" in infos:
        return f"{name}{joint}"
    signals = [n for n, i in infos.items() if i.kind == "signal"]
    raise AcquisitionError(
        f"the program has no signal {name}[{joint - 1}] or {name}{joint}: name input and output;"
        f" it declares {', '.join(signals) or 'no signal'}"
    )


def _unit(infos: Mapping[str, Any], name: str) -> str:
    info = infos.get(name) or infos.get(name.partition("[")[0])
    return str(info.unit) if info is not None else ""


def shown_lines(rows: Sequence[Mapping[str, float]]) -> list[list[str]]:
    """Return the rows as text for a table."""
    digits = ("{:.3g}", "{:.2f}", "{:.1f}", "{:.2g}", "{:.2g}", "{:.3f}")
    return [[form.format(v) for form, v in zip(digits, row.values(), strict=True)] for row in rows]
