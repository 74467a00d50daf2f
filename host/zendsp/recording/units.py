"""Units as people write them, and their factors to SI."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]

# symbol: (factor to SI, what it is in SI)
WHOLE = {
    "deg": (math.pi / 180, "rad"),
    "degree": (math.pi / 180, "rad"),
    "degrees": (math.pi / 180, "rad"),
    "°": (math.pi / 180, "rad"),
    "mdeg": (math.pi / 180e3, "rad"),
    "arcmin": (math.pi / 10800, "rad"),
    "arcsec": (math.pi / 648000, "rad"),
    "Grad": (math.pi / 180, "rad"),
    "gon": (math.pi / 200, "rad"),
    "rev": (2 * math.pi, "rad"),
    "turn": (2 * math.pi, "rad"),
    "turns": (2 * math.pi, "rad"),
    "radian": (1.0, "rad"),
    "radians": (1.0, "rad"),
    "rpm": (math.pi / 30, "rad/s"),
    "1/min": (math.pi / 30, "rad/s"),
    "rev/min": (math.pi / 30, "rad/s"),
    "U/min": (math.pi / 30, "rad/s"),
    "tr/min": (math.pi / 30, "rad/s"),
    "Nmm": (1e-3, "N m"),
    "Ncm": (1e-2, "N m"),
    "dps": (math.pi / 180, "rad/s"),
    "rps": (2 * math.pi, "rad/s"),
    "sec": (1.0, "s"),
    "secs": (1.0, "s"),
    "second": (1.0, "s"),
    "seconds": (1.0, "s"),
    "min": (60.0, "s"),
    "h": (3600.0, "s"),
    "day": (86400.0, "s"),
    "days": (86400.0, "s"),
    "msec": (1e-3, "s"),
    "usec": (1e-6, "s"),
    "nsec": (1e-9, "s"),
    "in": (0.0254, "m"),
    "inch": (0.0254, "m"),
    "ft": (0.3048, "m"),
    "lbf": (4.4482216152605, "N"),
    "kgf": (9.80665, "N"),
    "amp": (1.0, "A"),
    "amps": (1.0, "A"),
    "volt": (1.0, "V"),
    "volts": (1.0, "V"),
}
BASE = ("rad", "Nm", "Hz", "m", "s", "N", "A", "V", "W", "J", "g", "K")
PREFIX = {
    "": 1.0, "k": 1e3, "M": 1e6, "c": 1e-2, "m": 1e-3, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "n": 1e-9,
}
_ENERGY = {"kg": 1, "m": 2, "s": -2}
POWERS_OF: Mapping[str, Mapping[str, int]] = {
    "1": {}, "rad": {}, "rad/s": {"s": -1}, "Hz": {"s": -1}, "m": {"m": 1}, "s": {"s": 1},
    "N": {"kg": 1, "m": 1, "s": -2}, "N m": _ENERGY, "J": _ENERGY, "W": {**_ENERGY, "s": -3},
    "V": {**_ENERGY, "s": -3, "A": -1}, "A": {"A": 1}, "kg": {"kg": 1}, "K": {"K": 1},
}  # fmt: skip
KNOWN = (
    "rad, deg, gon, rev, rpm, m, mm, in, s, ms, Hz, N, N m, mN m, Nmm, kg, g, A, mA, V, W, and what"
    " they make with blanks, powers and a slash: 'kg cm^2', 'N m s/rad', 'deg/s'"
)
ENCODER = ("counts", "count", "ticks")  # what the model's [sensor] matrix makes rad or m of
AS_WRITTEN = ("%", "°C", "degC", *ENCODER)  # numbers that are left as they are
# suffixes of names that say nothing else; `_ms` is milliseconds only where a word of the rest names
# a time
SUFFIXES = {
    "rad": "rad",
    "radians": "rad",
    "mrad": "mrad",
    "urad": "urad",
    "deg": "deg",
    "degrees": "deg",
    "grad": "deg",  # German
    "rpm": "rpm",
    "dps": "deg/s",
    "degps": "deg/s",
    "Nm": "N m",  # `_nm` may be nanometres
    "mnm": "mN m",
    "Nmm": "Nmm",
    "Ncm": "Ncm",
    "kN": "kN",
    "mm": "mm",
    "ma": "mA",
    "counts": "counts",
}
TIME_SUFFIXES = {"ms": "ms", "us": "us", "ns": "ns", "sec": "s", "s": "s"}
TIME_NAMES = {"t", "time", "timestamp", "stamp", "clock", "elapsed"}
TIME_NAMES |= {"zeit", "tijd", "tid", "temps", "tempo", "tiempo", "czas", "aika"}

FORCE_NAMES = {"force", "kraft", "thrust"}  # of others an N at the end may be a number

_FACTOR = re.compile(r"^(?P<symbol>[^\d^²³\-+]+)\^?(?P<power>[+-]?\d+|²|³)?$")
_LAST = re.compile(r"(?P<rest>.+)[_.:](?P<last>[^_.:]+)$")
_CAMEL = re.compile(r"(?P<rest>.*[a-z\d])(?P<last>Deg|Degrees|Grad|Rad|Mrad|Rpm|Dps|Nm|Ms|Us)$")
_WORDS = re.compile(r"[^\W\d_]+")
# between the symbols of a product: a blank, a multiplication sign, or N.m and N-m
_TIMES = re.compile(r"[\s·*⋅]+|[.-](?=[^\W\d_])")
_POWERS = {"²": 2, "³": 3}


def to_si(unit: str) -> tuple[float, str] | None:
    """The factor from a unit to SI and the SI unit; None where the unit is not known.

    Examples
    --------
    >>> to_si("mN m"), to_si("N·mm"), to_si("rad")
    ((0.001, 'N m'), (0.001, 'N m'), (1.0, 'rad'))
    >>> factor, name = to_si("deg/s^2")
    >>> round(factor, 6), name
    (0.017453, 'rad/s^2')
    >>> to_si("furlong") is None
    True
    """
    text = unit.strip()
    if text in AS_WRITTEN:
        return 1.0, text
    if text in WHOLE:
        return WHOLE[text]
    over, *under = text.replace("per ", "/").split("/")
    factor, names = _product(over)
    below: list[str] = []
    for part in under:
        divisor, symbols = _product(part.strip("()"))
        factor /= divisor
        below += symbols
    if math.isnan(factor) or not names or (under and not below):
        return None
    known = " ".join(names)
    if factor == 1.0:
        return 1.0, _TIMES.sub(" ", text)  # its author's symbols
    return factor, known + ("/" + "/".join(below) if below else "")


def dimension(unit: str) -> dict[str, int] | None:
    """The powers of kg, m, s, A and K in a unit, without those that are 0; None where it is not
    known. An angle has none; numbers such as ``counts`` are of their own kind.

    Examples
    --------
    >>> dimension("N m") == dimension("mNm") == dimension("J"), dimension("rpm"), dimension("A")
    (True, {'s': -1}, {'A': 1})
    >>> dimension("counts"), dimension("furlong") is None
    ({'counts': 1}, True)
    """
    text = unit.strip()
    if text in AS_WRITTEN:
        return {text: 1}
    if text in WHOLE:
        text = WHOLE[text][1]
    over, *under = text.replace("per ", "/").split("/")
    found: dict[str, int] = {}
    for sign, part in [(1, over), *((-1, part.strip("()")) for part in under)]:
        factor, names = _product(part)
        if math.isnan(factor):
            return None
        for name in names:
            symbol, _, power = name.partition("^")
            for base, n in POWERS_OF[symbol].items():
                found[base] = found.get(base, 0) + sign * n * int(power or 1)
    return {base: n for base, n in found.items() if n}


def not_known(unit: str) -> str:
    """A sentence on a unit that is not known, with those that are."""
    return f"the unit {unit!r} is not known. Known are {KNOWN}"


def _product(text: str) -> tuple[float, list[str]]:
    """Factor and SI symbols of a product such as ``mN m``; NaN where a symbol is unknown."""
    factor, names = 1.0, []
    for part in _TIMES.split(text.strip()):
        if part == "1":
            names.append("1")
            continue
        match = _FACTOR.match(part)
        found = _symbol(match["symbol"]) if match else None
        if match is None or found is None:
            return math.nan, []
        power = int(_POWERS.get(match["power"], match["power"] or 1))
        factor *= found[0] ** power
        names.append(found[1] + (f"^{power}" if power != 1 else ""))
    return factor, names


def _symbol(text: str) -> tuple[float, str] | None:
    if text in WHOLE:
        return WHOLE[text]
    for base in BASE:
        if text.endswith(base) and (prefix := text[: -len(base)]) in PREFIX:
            factor = PREFIX[prefix]
            if base == "g":
                return factor * 1e-3, "kg"
            return factor, "N m" if base == "Nm" else base
    return None


def unit_in_name(name: str) -> str:
    """The unit in which a name ends (``theta_deg``, ``theta.deg``, ``thetaDeg``, ``t_ms``); empty
    where it has none.

    Examples
    --------
    >>> unit_in_name("theta_deg"), unit_in_name("t_ms"), unit_in_name("v_ms"), unit_in_name("Kp")
    ('deg', 'ms', '', '')
    >>> unit_in_name("force_N"), unit_in_name("gain_N"), unit_in_name("enc_counts")
    ('N', '', 'counts')
    """
    bare = name.partition("[")[0]
    parts = _LAST.match(re.sub("_N_m$", "_Nm", bare)) or _CAMEL.match(bare)
    if parts is None:
        return ""
    rest, last = parts["rest"], parts["last"]
    if TIME_NAMES & set(_WORDS.findall(rest.lower())):
        return TIME_SUFFIXES.get(last.lower(), "")
    if last == "N":
        return "N" if FORCE_NAMES & set(_WORDS.findall(rest.lower())) else ""
    return SUFFIXES.get(last) or SUFFIXES.get(last.lower(), "")


def in_si(
    columns: Mapping[str, FloatArray], units: Mapping[str, str]
) -> tuple[dict[str, FloatArray], dict[str, str], tuple[str, ...]]:
    """Columns in SI units, their units, and a sentence for what was converted.

    Parameters
    ----------
    columns : mapping of name to array
    units : mapping of name to str
        Where it says nothing, a name such as ``theta_deg`` does.

    Returns
    -------
    columns, units : dict
        A unit that is not known is left, with its numbers.
    notes : tuple of str
    """
    converted, said, notes = dict(columns), dict(units), []
    for name, values in columns.items():
        unit = units.get(name) or unit_in_name(name)
        known = to_si(unit) if unit else None
        if known is None:
            continue
        factor, said[name] = known
        if factor != 1.0:
            converted[name] = values * factor
            notes.append(f"{name}: {unit} converted to {said[name]}")
    return converted, said, tuple(notes)
