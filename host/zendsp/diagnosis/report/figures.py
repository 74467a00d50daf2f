"""The pictures of a report, each answering one question."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from zendsp.diagnosis.measure.where import Missing, energy, mismatch
from zendsp.diagnosis.measure.windows import window_error
from zendsp.diagnosis.result import Diagnosis, Finding
from zendsp.physics.effects import library
from zendsp.physics.fit import Data
from zendsp.physics.joint import run

Array = npt.NDArray[np.float64]

BEFORE, AFTER, DATA, FLOOR = (
    "#b4451f",
    "#1f5fa8",
    "#9a9a9a",
    "#3a7d44",
)  # apart for colour-blind readers, and in grey


def axis_of(effect: str) -> str:
    """The variable over which an effect is best seen."""
    return (
        library()[effect].over
        if effect in library()
        else "time" if effect == "disturbance" else "velocity"
    )


def _style() -> None:
    plt.rcParams.update(
        {
            "font.size": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "figure.dpi": 110,
            "axes.grid": True,
            "grid.alpha": 0.25,
        }
    )


def _units(d: Diagnosis, joint: int) -> dict[str, str]:
    q = "m" if d.given.joint_kind(joint) == "linear" else "rad"
    force = d.given.torque_unit(joint)
    return {
        "position": q,
        "velocity": f"{q}/s",
        "acceleration": f"{q}/s²",
        "command": d.given.actuator.unit or force,
        "time": "s",
        "torque": force,
    }


def _thin(count: int, most: int = 6000) -> slice:
    return slice(None, None, max(1, count // most))


def error_figure(d: Diagnosis, joint: int) -> Figure:
    """Does the improved model predict the held-out recording better, and how close is it to the
    noise?
    """
    test: Data = d.details["test"]
    whole = d.details["whole"]
    figure, (top, bottom) = plt.subplots(
        2, 1, figsize=(7.2, 4.6), height_ratios=[2, 1], layout="constrained"
    )
    unit = _units(d, joint)["position"]
    period = test.records[0][joint - 1].sample_time
    for model, colour, label in (
        (whole.calibrated, BEFORE, "calibrated"),
        (whole.improved, AFTER, "improved"),
    ):
        error = window_error(test, model, joint)
        t = np.arange(len(error)) * period
        cut = _thin(len(error))
        top.plot(t[cut], error[cut], color=colour, lw=0.6, label=label)
        size = 250
        blocks = error[: len(error) // size * size].reshape(-1, size)
        bottom.semilogy(
            (np.arange(len(blocks)) + 0.5) * size * period,
            np.sqrt(np.mean(blocks**2, axis=1)) + 1e-300,
            color=colour,
            lw=1.2,
        )
    bottom.axhline(max(d.noise_floor, 1e-300), color=FLOOR, ls="--", lw=1, label="noise floor")
    top.set(
        ylabel=f"position error [{unit}]",
        title=f"Joint {joint}: held-out recording, free simulation over 0.25 s",
    )
    bottom.set(xlabel="time [s]", ylabel=f"RMS [{unit}]")
    _legend(figure, top, bottom)
    return figure


def torque_figure(d: Diagnosis, joint: int) -> Figure:
    """Which torque did the calibrated model lack, and when?"""
    before: list[Missing] = d.missing[joint]
    after: list[Missing] = d.remaining[joint]
    figure, axis = plt.subplots(figsize=(7.2, 2.8), layout="constrained")
    unit = _units(d, joint)["torque"]
    offset = 0.0
    for k, (a, b) in enumerate(zip(before, after, strict=True)):
        cut = _thin(len(a.time))
        t = a.time - a.time[0] + offset
        axis.plot(
            t[cut], a.torque[cut], color=BEFORE, lw=0.7, label="calibrated" if k == 0 else None
        )
        axis.plot(t[cut], b.torque[cut], color=AFTER, lw=0.7, label="improved" if k == 0 else None)
        offset += float(t[-1] - t[0])
    for start, stop in d.times[:4]:
        axis.axvspan(
            start - before[0].time[0], stop - before[0].time[0], color="#e8c39e", alpha=0.4, lw=0
        )
    axis.set(
        xlabel="time [s]",
        ylabel=_torque_label(unit),
        title=f"Joint {joint}: what the model lacks along the recordings of the fit",
    )
    _legend(figure, axis)
    return figure


def map_figure(d: Diagnosis, joint: int) -> Figure:
    """Where in position and velocity does the mismatch live?"""
    units = _units(d, joint)
    q = np.concatenate([m.variables["position"] for m in d.missing[joint]])
    v = np.concatenate([m.variables["velocity"] for m in d.missing[joint]])
    e = np.concatenate([energy(m) for m in d.missing[joint]])
    figure, (left, right) = plt.subplots(
        1, 2, figsize=(7.2, 3.0), layout="constrained", width_ratios=[1.4, 1]
    )
    total, xs, ys = np.histogram2d(q, v, bins=28, weights=e)
    count, _, _ = np.histogram2d(q, v, bins=(xs, ys))
    with np.errstate(invalid="ignore"):
        mean = np.sqrt(np.where(count > 0, total / np.maximum(count, 1), np.nan))
    picture = left.pcolormesh(xs, ys, mean.T, cmap="magma_r")
    figure.colorbar(picture, ax=left, label=f"missing, RMS [{units['torque']}]")
    left.set(
        xlabel=f"position [{units['position']}]",
        ylabel=f"velocity [{units['velocity']}]",
        title=f"Joint {joint}: where the mismatch lives",
    )
    edges = np.quantile(v, np.linspace(0, 1, 25))
    edges = np.unique(edges)
    bins = np.clip(np.searchsorted(edges, v, side="right") - 1, 0, len(edges) - 2)
    share = np.bincount(bins, e, len(edges) - 1) / max(e.sum(), 1e-300)
    time = np.bincount(bins, minlength=len(edges) - 1) / len(v)
    centre = 0.5 * (edges[1:] + edges[:-1])
    right.bar(centre, share, width=np.diff(edges), color=BEFORE, alpha=0.8, label="of the mismatch")
    right.step(centre, time, where="mid", color="black", lw=1, label="of the time")
    right.set(xlabel=f"velocity [{units['velocity']}]", ylabel="share")
    _legend(figure, right)
    return figure


def law_figure(d: Diagnosis, finding: Finding) -> Figure:
    """What does the law that was found look like over the data, and what stays when it is there?"""
    whole, train = d.details["whole"], d.details["train"]
    joint, units = finding.joint, _units(d, finding.joint)
    name = axis_of(finding.effect)
    terms = [t for t in whole.improved.at(joint) if t.effect == finding.effect]
    without = whole.improved.with_terms(tuple(t for t in whole.improved.terms if t not in terms))
    figure, panels = plt.subplots(
        1, 2, figsize=(7.2, 3.2), layout="constrained", sharex=True, sharey=True
    )
    lacks, left = mismatch(train, without, joint), mismatch(train, whole.improved, joint)
    x = np.concatenate([m.time if name == "time" else m.variables[name] for m in lacks])
    before, after = (np.concatenate([m.torque for m in found]) for found in (lacks, left))
    cut = _thin(len(x), 5000)
    for axis, y, colour, title in (
        (panels[0], before, BEFORE, f"without {finding.effect}"),
        (panels[1], after, AFTER, f"with {finding.effect}"),
    ):
        axis.plot(x[cut], y[cut], ".", color=DATA, ms=1.5, alpha=0.35, rasterized=True)
        centre, mean, spread = _binned(x, y)
        axis.errorbar(
            centre,
            mean,
            spread,
            color=colour,
            fmt="o",
            ms=3,
            lw=0.8,
            label="what the model lacks: samples, means",
        )
        axis.set(xlabel=f"{name} [{units[name]}]", title=title)
    centre, mean, _ = _binned(x, before - after, 120)
    panels[0].plot(centre, mean, color="black", lw=1.2, label=f"{finding.effect}, as found")
    low, high = np.quantile(before, [0.005, 0.995])
    panels[0].set_ylim(low - 0.15 * (high - low), high + 0.15 * (high - low))
    panels[0].set_ylabel(_torque_label(units["torque"]))
    figure.suptitle(f"Joint {joint}: torque that the model lacks", fontsize=10)
    _legend(figure, panels[0])
    return figure


def _torque_label(unit: str) -> str:
    return f"{'force' if unit == 'N' else 'torque'} [{unit}]"


def _legend(figure: Figure, *axes: Axes) -> None:
    """Below the figure, where it covers no data."""
    entries = {
        label: handle
        for axis in axes
        for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(
        list(entries.values()),
        list(entries),
        loc="outside lower center",
        ncols=4,
        frameon=False,
        fontsize=8,
    )


def _too_fine(d: Diagnosis, finding: Finding) -> bool:
    """Whether a pattern repeats too often over the travel to be drawn, and faster than the torque
    in the figure is seen.
    """
    order = finding.parameters.get("order")
    travel = max(rec[finding.joint - 1].scale.position for rec in d.details["train"].records)
    return order is not None and order.value * travel > 40 * 2 * np.pi


def _binned(x: Array, y: Array, count: int = 40) -> tuple[Array, Array, Array]:
    edges = np.linspace(float(np.quantile(x, 0.001)), float(np.quantile(x, 0.999)), count + 1)
    bins = np.searchsorted(edges, x, side="right") - 1
    good = (bins >= 0) & (bins < count)
    bins, y = bins[good], y[good]
    n = np.bincount(bins, minlength=count)
    use = n > 4
    mean = np.bincount(bins, y, count)[use] / n[use]
    square = np.bincount(bins, y**2, count)[use] / n[use]
    spread = np.sqrt(np.maximum(square - mean**2, 0) / n[use])
    return (0.5 * (edges[1:] + edges[:-1]))[use], mean, spread


def white_figure(d: Diagnosis, joint: int) -> Figure:
    """Is anything predictable left in what the improved model does not predict?"""
    whole = d.details["whole"]
    figure, axis = plt.subplots(figsize=(7.2, 2.4), layout="constrained")
    test: Data = d.details["test"]
    for model, colour, label in (
        (whole.calibrated, BEFORE, "calibrated"),
        (whole.improved, AFTER, "improved"),
    ):
        record = test.records[0][joint - 1]
        r = run(record, model, 16.0).innovations[record.n // 20 :]
        r = r - r.mean()
        spectrum = np.abs(np.fft.rfft(r, 2 * len(r))) ** 2
        correlation = np.fft.irfft(spectrum)[:201]
        axis.plot(
            np.arange(1, 201) * record.sample_time,
            correlation[1:] / max(correlation[0], 1e-300),
            color=colour,
            lw=1.1,
            label=label,
        )
    bound = 1.96 / np.sqrt(test.records[0][joint - 1].n)
    axis.axhspan(-bound, bound, color=FLOOR, alpha=0.2, lw=0)
    axis.set(
        xlabel="lag [s]",
        ylabel="autocorrelation",
        title=f"Joint {joint}: one-step errors on the held-out recording (band: white noise)",
    )
    _legend(figure, axis)
    return figure


def draw_all(d: Diagnosis, out: Path) -> list[tuple[str, str, Path]]:
    """Draw every figure of a report into a folder.

    Parameters
    ----------
    d : Diagnosis
    out : Path
        Folder; PNG files are written there.

    Returns
    -------
    list of (section, caption, path)
    """
    _style()
    figures: list[tuple[str, str, str, Callable[[], Figure]]] = []
    joints = sorted({f.joint for f in d.findings} | {r.joint for r in d.regions[:1]}) or [1]
    for j in joints[:7]:
        figures.append(
            (
                "fit",
                f"Joint {j}: error on the held-out recording",
                f"error_joint{j}.png",
                partial(error_figure, d, j),
            )
        )
    for k, f in enumerate(d.findings, 1):
        if any(
            t.effect == f.effect for t in d.details["whole"].improved.at(f.joint)
        ) and not _too_fine(d, f):
            figures.append(
                (
                    "law",
                    f.sentence,
                    f"law_{k}_{f.effect}_joint{f.joint}.png",
                    partial(law_figure, d, f),
                )
            )
    for j in joints[:7]:
        figures.append(
            (
                "where",
                f"Joint {j}: the torque that the calibrated model lacks",
                f"torque_joint{j}.png",
                partial(torque_figure, d, j),
            )
        )
        figures.append(
            (
                "where",
                f"Joint {j}: map of the mismatch",
                f"map_joint{j}.png",
                partial(map_figure, d, j),
            )
        )
        figures.append(
            (
                "white",
                f"Joint {j}: whiteness",
                f"whiteness_joint{j}.png",
                partial(white_figure, d, j),
            )
        )
    done = []
    for section, caption, name, draw in figures:
        figure = draw()
        figure.savefig(out / name)
        plt.close(figure)
        done.append((section, caption, out / name))
    return done
