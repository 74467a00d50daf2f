"""The colours of traces are distinct on every background, also for colour-blind eyes."""

from __future__ import annotations

import numpy as np
import pytest
from textual.color import Color

from zendsp.tui.colours import DARK, LIGHT


def _contrast(a: str, b: str) -> float:
    la, lb = (Color.parse(c).rgb for c in (a, b))

    def luminance(rgb: tuple[int, int, int]) -> float:
        parts = [
            c / 255 / 12.92 if c / 255 <= 0.03928 else ((c / 255 + 0.055) / 1.055) ** 2.4
            for c in rgb
        ]
        return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2]

    high, low = sorted((luminance(la), luminance(lb)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_traces_stand_out_from_dark_and_light_backgrounds() -> None:
    assert min(_contrast(c, "#0E1216") for c in DARK) >= 3.0  # WCAG 1.4.11 for graphics
    assert min(_contrast(c, "#F4F5F6") for c in LIGHT) >= 3.0


def _machado(rgb: np.ndarray, kind: str) -> np.ndarray:
    """Colours as seen with full dichromacy (Machado, Oliveira, Fernandes 2009, table 1, severity
    1.0), linear RGB.
    """
    matrix = {
        "protan": [
            [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ],
        "deutan": [
            [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ],
    }[kind]
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return np.clip(linear @ np.array(matrix).T, 0.0, 1.0)


def _lab(linear: np.ndarray) -> np.ndarray:
    xyz = (
        linear
        @ np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]).T
    )
    f = np.cbrt(xyz / np.array([0.9505, 1.0, 1.089]))
    return np.stack(
        (116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])), axis=1
    )


@pytest.mark.parametrize("kind", ["protan", "deutan"])
@pytest.mark.parametrize("palette", [DARK, LIGHT], ids=["dark", "light"])
def test_all_eight_traces_stay_apart_for_colour_blind_eyes(
    kind: str, palette: tuple[str, ...]
) -> None:
    rgb = np.array([Color.parse(c).rgb for c in palette]) / 255.0
    lab = _lab(_machado(rgb, kind))
    apart = np.linalg.norm(lab[:, None] - lab[None], axis=2) + 1e3 * np.eye(8)
    # CIE 1976: 2.3 is just noticeable; lines of dots need a few times that
    assert apart.min() > 15.0
