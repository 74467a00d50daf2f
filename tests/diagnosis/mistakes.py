"""Mistakes that people make in recordings, each with the words of its refusal."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import reality

Columns = dict[str, np.ndarray]


def clip(name: str, share: float) -> Callable[[Columns], None]:
    def change(c: Columns) -> None:
        top = share * np.max(np.abs(c[name]))
        c[name] = np.clip(c[name], -top, top)

    return change


def clip_position(c: Columns) -> None:
    c["q"] = np.minimum(c["q"], c["q"].min() + 0.75 * np.ptp(c["q"]))


def scale(factor: float, *names: str) -> Callable[[Columns], None]:
    def change(c: Columns) -> None:
        for name in names:
            c[name] = factor * c[name]

    return change


def set_value(c: Columns) -> None:
    c["u"] = c["r"].copy()


def before_a_gear(c: Columns) -> None:
    scale(50.0, "q", "r")(c)
    scale(1 / 50.0, "u")(c)


def swap(c: Columns) -> None:
    c["q"], c["u"] = c["u"], c["q"]


def nan(c: Columns) -> None:
    c["q"][1000] = np.nan


def infinite(c: Columns) -> None:
    c["u"][7] = np.inf


def huge(c: Columns) -> None:
    c["q"][2000] = -1e300


def refreshed(c: Columns) -> None:
    c["q"] = np.repeat(c["q"][::5], 5)[: len(c["q"])]


def constant(c: Columns) -> None:
    c["q"] = np.full_like(c["q"], 0.25)


def dither(c: Columns) -> None:
    c["q"] = reality.RESOLUTION * (np.arange(len(c["q"])) % 7 == 0)


def noise(c: Columns) -> None:
    c["q"] = 0.3 + 1e-2 * np.random.default_rng(1).standard_normal(len(c["q"]))


def glued(c: Columns) -> None:
    n = len(c["q"])
    for name in ("q", "u", "r"):
        c[name] = np.concatenate([c[name][: n // 3], c[name][n // 2 :]])
    c["t"] = c["t"][: len(c["q"])]


def hung(c: Columns) -> None:
    speed = np.abs(c["q"][7:] - c["q"][:-7])
    for part in (slice(1100, 1900), slice(2500, 2900)):
        k = part.start + int(np.argmax(speed[part]))
        c["q"][k : k + 60] = c["q"][k]


def glued_at_rest(c: Columns) -> None:
    n = len(c["q"])
    slow = np.abs(c["q"][7:] - c["q"][:-7])[: n // 2]
    k = 1000 + int(np.argmin(slow[1000:]))
    rest = np.full(400, c["q"][k])
    c["q"] = np.concatenate([c["q"][:k], rest, c["q"][k] + 1.0 + c["q"][k + 400 :]])


def dropped_out(c: Columns) -> None:
    c["q"][1000:1020] = c["q"].max() + 17.0


def velocity(c: Columns) -> None:
    c["q"] = np.gradient(c["q"], c["t"])


def reference(c: Columns) -> None:
    c["q"] = c["r"].copy()


def repeated(c: Columns) -> None:
    for name in c:
        c[name] = np.concatenate([c[name], c[name]])


def few_digits(c: Columns) -> None:
    c["t"] = np.round(1.7e9 + c["t"], -1)  # of a calendar's stamp nine digits were printed


def shifted(c: Columns) -> None:
    c["u"] = np.roll(c["u"], len(c["u"]) // 3)


def unexcited(c: Columns) -> None:
    c["u"] = np.full_like(c["u"], 0.2)


def silent(c: Columns) -> None:
    c["u"] = np.zeros_like(c["u"])


BAD: dict[str, tuple[Callable[[Columns], None], str]] = {
    "degrees": (scale(180 / np.pi, "q", "r"), "degrees"),
    "degrees beside a reference in radians": (scale(180 / np.pi, "q"), "degrees"),
    "command in milli-units": (scale(1000.0, "u"), "[actuator], such as mA in place of A?"),
    "command in units under a head of milli-units": (
        scale(0.001, "u"), "N m under a head that says mN m? Write the unit",
    ),
    "a torque before a gear": (scale(1 / 50.0, "u"), "on the other side of a gear"),
    "position and torque before a gear": (before_a_gear, "torque of a motor before a gear of"),
    "the set value in place of the command": (set_value, "names a set value of the position"),
    "sign of the command": (scale(-1.0, "u"), "sign of the command or of the position is flipped"),
    "sign of the position": (scale(-1.0, "q"), "flipped"),
    "swapped columns": (swap, "swapped"),
    "NaN": (nan, "row 1001"),
    "nothing but NaN": (scale(np.nan, "q"), "No row is left without: is it the right column"),
    "infinite": (infinite, "row 8: inf"),
    "too large to be squared": (huge, "row 2001: -1e+300"),
    "constant position": (constant, "constant"),
    "position read more seldom than it is logged": (refreshed, "one row of 5 only"),
    "constant command": (unexcited, "constant"),
    "no command": (silent, "zero throughout"),
    "one count of motion": (dither, "counts"),
    "noise": (noise, "noise"),
    "clipped position": (clip_position, "clipped"),
    "clipped command": (clip("u", 0.4), "clipped"),
    "two runs glued": (glued, "glued"),
    "two runs glued, the first one at rest": (glued_at_rest, "glued"),
    "the same run twice": (repeated, "glued"),
    "a sensor that hung": (hung, "the sensor hung, or was not read"),
    "a sensor that dropped out": (dropped_out, "for 20 rows from row 1001"),
    "a velocity in place of the position": (velocity, "names a velocity as the position"),
    "the set value in place of the position": (reference, "name the column of the sensor"),
    "command of another run": (shifted, "different runs"),
    "time in few digits": (few_digits, "stands still at row 2, at 1700000000: is it written"),
    "time in milliseconds": (scale(1000.0, "t"), "seconds"),
}
