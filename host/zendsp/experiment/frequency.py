"""Frequency response of a running machine, to a multisine played from the program's own table, on
the target's own clock.

Estimator: the spectra of P whole periods of input u and output y, G = mean(Y) / mean(U) at each
excited line. Averages over periods converge to the response to the excitation, so that G is right
in a closed loop too, where Y U* / U U* is not (Pintelon and Schoukens 2012, chapter 2). Coherence
is the part of both signals' power that repeats from period to period. The standard deviation of G
is the larger of two: that of the part that does not repeat, and that of the distortion which a
nonlinear machine adds alike in every period. The latter is seen at harmonics that were not excited
(the same, chapter 4).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from zendsp.errors import AcquisitionError, Refused
from zendsp.experiment.excite import play
from zendsp.experiment.response import Complex, Floats, FrequencyResponse
from zendsp.link import Target
from zendsp.link.transfer import need_channels
from zendsp.prompt import shows_progress
from zendsp.recording.notes import ResponseNote
from zendsp.reference.crest import low_crest_phases
from zendsp_protocol.messages import Limits, MachineInfo, VariableInfo
from zendsp_protocol.states import VariableKind

REACH = 0.4  # of the sample rate: a line above is too near to half of it
LEAST_RAD, LEAST_M = 0.02, 0.002
COUNTS = 100.0  # of the encoder: a swing of a few is its steps, and dry friction holds it
TRAVEL = 0.1  # of all that there is between the limits of the position
SPEED_S = 0.007  # peak over limit of the speed: 0.5 to 30 Hz reach 28 times the peak a second
PART = 0.05  # of the torque limit: a small joint of an arm swings far by more
BESIDE = 2  # harmonics on either side of a line that tell its distortion


@shows_progress
def frequency_response(
    target: Target,
    *,
    joint: int = 1,
    f_min: float = 0.5,
    f_max: float = 30.0,
    lines: int = 30,
    amplitude: float | None = None,
    quantity: Literal["position", "torque"] = "position",
    input: str = "",
    output: str = "",
    periods: int = 6,
    channels: Sequence[str] = (),
    rehearsed: bool = True,
    progress: Callable[[float], None] | None = None,
) -> FrequencyResponse:
    """Measure a frequency response with the loaded program, which follows its table ``ref``.

    One joint swings about its position by a multisine of low crest factor, whose lines are
    multiples of ``f_min``, nearly evenly spaced in log f; the other joints are held. The first
    period is not used, since transients die away in it. On the fast clock the program is paused and
    starts with the recording; on the real clock it goes on running. Afterwards the machine is at
    its position before and the program does what it did before: parameters and tables are restored.

    Parameters
    ----------
    target : Target
        With a program loaded that plays tables (docs/references.md): pd.c, joint_pd.c and others.
    joint : int
        From 1.
    f_min, f_max : float
        Hz. The period is 1 / ``f_min``.
    lines : int
        Frequencies at the most. Of neighbouring multiples every third is left out: what shows there
        is distortion.
    amplitude : float, optional
        Peak of the multisine, rad (m), or N m (N). Of a position, line k has amplitude ~ 1/k.
        Default: `usual_amplitude`.
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
        Called with the fraction done; first, with 0, once all is checked.

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
    samples = round(rate / f_min) if f_min > 0.0 else 0
    harmonics = choose_lines(samples, f_max / f_min if samples else 0.0, lines, rate)
    if periods < 2:
        raise AcquisitionError(f"periods = {periods}: at least 2, to tell what repeats")
    if amplitude is None:
        amplitude, _ = usual_amplitude(target.machine(), target.limits(), joint, quantity)
    if not 0.0 < amplitude < math.inf:
        raise AcquisitionError(f"amplitude = {amplitude:g}: expected more than 0 rad (m, N m, N)")
    need_channels(target.request, [given, found], target.status())
    if progress is not None:
        progress(0.0)
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
    bent = distortion(u[used], y[used], periods, harmonics, gain)
    std = np.fmax(std, bent)
    unit = _ratio(_unit(infos, found), _unit(infos, given))
    kept = ResponseNote(
        f=f.tolist(), real=gain.real.tolist(), imaginary=gain.imag.tolist(), std=std.tolist(),
        coherence=coherence.tolist(), distortion=bent.tolist(), input=given, output=found,
        unit=unit, periods=periods,
    )
    recording = replace(recording, extra={**recording.extra, "frequency_response": kept})
    return FrequencyResponse(
        f, gain, std, coherence, bent, given, found, unit, periods, recording
    )  # fmt: skip


def usual_amplitude(
    machine: MachineInfo,
    limits: Limits,
    joint: int,
    quantity: Literal["position", "torque"] = "position",
) -> tuple[float, str]:
    """A peak that stands out from friction and encoder steps and stays far below the limits, and
    its unit.

    For a position it is 0.02 rad (2 mm), or 100 counts of the encoder where that is more; at most a
    tenth of the travel, and at most what keeps the default band below a fifth of the speed limit.
    For a torque it is 5 % of its limit.

    Parameters
    ----------
    machine : MachineInfo
    limits : Limits
    joint : int
        From 1.
    quantity : {"position", "torque"}

    Returns
    -------
    peak : float
        To two digits.
    unit : str
        rad (m), or N m (N).

    Raises
    ------
    Refused
        There is no such joint.
    AcquisitionError
        There is no limit of its torque to go by.
    """
    if not 1 <= joint <= len(machine.joints):
        raise Refused(f"joint {joint}: the machine has {len(machine.joints)}, counted from 1")
    j, info = joint - 1, machine.joints[joint - 1]
    unit = info.unit
    if quantity == "torque":
        unit = "N" if info.unit == "m" else "N m"
        peak = PART * limits.torque_max[j]
        if not 0.0 < peak < math.inf:
            raise AcquisitionError(f"joint {joint} has no torque limit to go by: give amplitude")
    else:
        least = LEAST_M if info.unit == "m" else LEAST_RAD
        travel = limits.position_max[j] - limits.position_min[j]
        peak = max(least, COUNTS / abs(info.counts_per_unit or math.inf))
        peak = min(peak, TRAVEL * travel, SPEED_S * limits.speed_max[j])
    return float(f"{peak:.2g}"), unit


def choose_lines(samples: int, ratio: float, most: int, rate: float) -> npt.NDArray[np.int64]:
    """Harmonics of a period, nearly evenly spaced in log f, with gaps among the low ones.

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
    chosen: list[int] = []
    wanted = np.unique(np.rint(spaced).astype(np.int64)).tolist()
    for k in wanted:
        if chosen[-2:] != [k - 2, k - 1] or k == wanted[-1]:
            chosen.append(k)
    return np.array(chosen, dtype=np.int64)


def make_period(
    harmonics: npt.NDArray[np.int64], amplitude: float, power: int, f_min: float, t: Floats
) -> Floats:
    """A multisine at times ``t`` (s) whose peak is ``amplitude``.

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
    """Response, standard deviation and coherence at the harmonics.

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


def distortion(
    u: Floats, y: Floats, periods: int, harmonics: npt.NDArray[np.int64], gain: Complex
) -> Floats:
    """The standard deviation of the response that a nonlinear machine causes.

    Parameters
    ----------
    u, y : ndarray, shape (periods * samples,)
        Whole periods of input and output.
    harmonics : ndarray of int, shape (n,)
        The excited ones, ascending.
    gain : ndarray of complex, shape (n,)
        The response at them.

    Returns
    -------
    ndarray, shape (n,)
        In the unit of ``gain``; it contains the noise at the same harmonics. NaN where nothing was
        excited.

    Notes
    -----
    A linear machine answers at excited harmonics only. At the others Y - G U, with G in between, is
    what friction, a gap or a limit adds. It adds as much at the excited ones (Pintelon and
    Schoukens 2012, section 4.3).
    """
    mean_u, mean_y = (np.fft.rfft(x.reshape(periods, -1).mean(axis=0)) for x in (u, y))
    known = np.isfinite(gain)
    if not known.any():
        return np.full(len(harmonics), np.nan)
    others = np.setdiff1d(np.arange(1, len(mean_u)), harmonics)
    f, known_f = np.log(others), np.log(harmonics[known])
    size = np.interp(f, known_f, np.log(np.maximum(np.abs(gain[known]), 1e-300)))
    turn = np.interp(f, known_f, np.unwrap(np.angle(gain[known])))
    left = np.abs(mean_y[others] - np.exp(size + 1j * turn) * mean_u[others]) ** 2
    at = np.searchsorted(others, harmonics)
    beside = [left[max(0, k - BESIDE) : k + BESIDE].mean() for k in at]
    given = np.where(known, np.abs(mean_u[harmonics]), np.nan)
    return np.asarray(np.sqrt(beside) / given)


def _among(name: str, channels: Sequence[str]) -> bool:
    return name in channels or name.partition("[")[0] in channels


def _first(infos: Mapping[str, VariableInfo], joint: int, name: str) -> str:
    """The signal of a joint: an array element, or a scalar with the joint's number."""
    if name in infos and infos[name].length >= joint:
        return f"{name}[{joint - 1}]" if infos[name].length > 1 else name
    if f"{name}{joint}" in infos:
        return f"{name}{joint}"
    signals = [n for n, i in infos.items() if i.kind == VariableKind.SIGNAL]
    raise AcquisitionError(
        f"the program has no signal {name}[{joint - 1}] or {name}{joint}: name input and output;"
        f" it declares {', '.join(signals) or 'no signal'}"
    )


def _unit(infos: Mapping[str, VariableInfo], name: str) -> str:
    info = infos.get(name) or infos.get(name.partition("[")[0])
    return info.unit if info is not None else ""


def _ratio(above: str, below: str) -> str:
    """Unit of a ratio; empty where both have the same."""
    if above == below or not below:
        return "" if above == below else above
    return f"{above or '1'} / ({below})"
