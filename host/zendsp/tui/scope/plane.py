"""The curves of the scope over another curve, or over frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from zendsp.tui.scope.path import Axes, Curve
from zendsp.tui.scope.settings import Channel

Floats = npt.NDArray[np.float64]


def over_selected(
    channels: Sequence[Channel], selected: int, y: Floats
) -> tuple[list[Curve], Axes]:
    """The curves of an XY plot: each over the selected one; a single curve over itself."""
    base = channels[selected]
    others = [k for k in range(len(channels)) if k != selected] or [selected]
    curves = [
        Curve(channels[k].name, np.stack((y[:, selected], y[:, k]), axis=1), k) for k in others
    ]
    units = {channels[k].unit for k in others}
    unit = units.pop() if len(units) == 1 else ""
    across = f"{base.name} [{base.unit}]" if base.unit else base.name
    return curves, Axes((across, unit), equal=bool(unit) and unit == base.unit)


def over_frequency(
    channels: Sequence[Channel],
    f: Floats,
    amplitude: Floats,
    lacking: str = "too few rows for a spectrum: widen the time (-)",
) -> tuple[list[Curve], Axes]:
    """The curves of a spectrum, both axes logarithmic; `lacking` says why there are none."""
    with np.errstate(divide="ignore", invalid="ignore"):
        x, y = np.log10(f), np.log10(amplitude)
    y[~np.isfinite(y)] = np.nan
    units = [f"{c.unit or '1'}/√Hz" for c in channels]
    same = len(set(units)) == 1
    curves = [
        Curve(c.name if same else f"{c.name} {unit}", np.stack((x, y[:, k]), axis=1), k)
        for k, (c, unit) in enumerate(zip(channels, units, strict=True))
    ]
    title = "" if len(f) else lacking
    above = units[0] if same else "…/√Hz"
    return curves, Axes(("f [Hz]", above), equal=False, title=title, log=True, log_x=True)
