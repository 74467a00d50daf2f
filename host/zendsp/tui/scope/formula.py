"""Curves that are computed from others: ``e = r1 - q1``, ``w = d(q[0])``, ``s = lp(u, 20)``.

An expression is turned once into nested functions of arrays; nothing is evaluated as Python.
Derivative and filter keep their state from block to block, so each row of a live curve is computed
once.
"""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.tui.scope.settings import Channel

Floats = npt.NDArray[np.float64]
Block = Mapping[str, Floats]  # values by name, and the times of the rows, s, as TIME
Step = Callable[[Block], Floats]
TIME = "t"
LONGEST = 200  # characters
_NAMED = re.compile(r"^\s*([A-Za-z_]\w*)\s*(?:\[([^\]]*)\])?\s*=(?!=)(.*)$", re.DOTALL)
_BINARY: dict[type[ast.operator], Callable[[Floats, Floats], Floats]] = {
    ast.Add: np.add, ast.Sub: np.subtract, ast.Mult: np.multiply, ast.Div: np.divide,
    ast.Pow: np.float_power,
}
_ONE: dict[str, Callable[[Floats], Floats]] = {
    name: getattr(np, name)
    for name in ("abs", "sqrt", "sin", "cos", "tan", "arctan", "exp", "log", "sign")
}
_TWO: dict[str, Callable[[Floats, Floats], Floats]] = {
    "min": np.minimum, "max": np.maximum, "atan2": np.arctan2,
}
FUNCTIONS = (*_ONE, *_TWO, "d", "lp")


class FormulaError(ValueError):
    """An expression that cannot be read; the message is for the person who typed it."""


@dataclass(frozen=True)
class Formula:
    """One expression over the signals of a program.

    Examples
    --------
    >>> Formula.read("e [rad] = r1 - q1").names
    ('r1', 'q1')
    """

    name: str
    unit: str
    expression: str
    names: tuple[str, ...]  # signals that it needs, in the order of their appearance

    @classmethod
    def read(cls, text: str, units: Mapping[str, str] | None = None) -> Formula:
        """Read ``name = expression`` or ``name [unit] = expression``.

        Parameters
        ----------
        units : mapping of str to str, optional
            Units of the signals that there are; others are refused. A sum or difference of one
            unit keeps it, a derivative is per second.

        Raises
        ------
        FormulaError
            With what was expected.
        """
        found = _NAMED.match(text)
        if found is None or len(text) > LONGEST:
            raise FormulaError("write name = expression, for example e = r1 - q1")
        name, unit, expression = found[1], found[2], found[3].strip()
        tree = _parse(expression)
        names = tuple(dict.fromkeys(_names(tree)))
        if units is not None:
            missing = [n for n in names if n not in units]
            if missing:
                raise FormulaError(f"no signal {missing[0]!r}; c lists them")
            if name in units:
                raise FormulaError(f"{name} is a signal of the program: take another name")
        made = _build(tree)(_probe(names))  # refuses what no curve can be made of
        if not np.isfinite(made).any():
            raise FormulaError(f"{expression!r} is no number, whatever the signals are")
        if unit is None:
            unit = _unit(tree, units or {}) or ""
        return cls(name, unit.strip(), expression, names)

    def begin(self) -> Step:
        """A function from blocks of rows to values, which keeps its state between blocks."""
        return _build(_parse(self.expression))


def _probe(names: Sequence[str]) -> Block:
    """Rows with small and large values of both signs, other ones for each signal."""
    size = np.geomspace(1e-3, 1e3, 24)
    values = np.concatenate((size, -size))
    block: dict[str, Floats] = {TIME: np.linspace(0.0, 0.05, len(values))}
    return block | {name: np.roll(values, 7 * k) + 1e-3 * k for k, name in enumerate(names)}


def _parse(expression: str) -> ast.expr:
    try:
        return ast.parse(expression, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise FormulaError(f"{expression!r} is not an expression") from None


def _signal(node: ast.AST) -> str | None:
    """The name of a signal: ``q1``, or ``q[0]``."""
    if isinstance(node, ast.Name):
        return node.id
    if (
        isinstance(node, ast.Subscript)
        and isinstance(node.value, ast.Name)
        and isinstance(node.slice, ast.Constant)
        and type(node.slice.value) is int
    ):
        return f"{node.value.id}[{node.slice.value}]"
    return None


def _names(node: ast.AST) -> list[str]:
    name = _signal(node)
    if name is not None:
        return [] if name in (TIME, "pi") else [name]
    children = node.args if isinstance(node, ast.Call) else ast.iter_child_nodes(node)
    return [name for child in children for name in _names(child)]


def _build(node: ast.expr) -> Step:
    name = _signal(node)
    if name == "pi":
        return lambda block: np.full(len(block[TIME]), math.pi)
    if name is not None:
        return lambda block: block[name]
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        value = _number(node)
        return lambda block: np.full(len(block[TIME]), value)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
        inner = _build(node.operand)
        return (lambda block: -inner(block)) if isinstance(node.op, ast.USub) else inner
    if isinstance(node, ast.BinOp) and type(node.op) in _BINARY:
        work, left, right = _BINARY[type(node.op)], _build(node.left), _build(node.right)
        return lambda block: _quiet(work, left(block), right(block))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return _call(node.func.id, node.args)
    raise FormulaError(
        f"{ast.unparse(node)[:40]!r} has no place here: signals, numbers, + - * / ** and"
        f" {', '.join(FUNCTIONS)}"
    )


def _call(name: str, given: Sequence[ast.expr]) -> Step:
    if name in _ONE and len(given) == 1:
        one, inner = _ONE[name], _build(given[0])
        return lambda block: _quiet(one, inner(block))
    if name in _TWO and len(given) == 2:
        two, left, right = _TWO[name], _build(given[0]), _build(given[1])
        return lambda block: _quiet(two, left(block), right(block))
    if name == "d" and len(given) == 1:
        return _Derivative(_build(given[0]))
    if name == "lp" and len(given) == 2:
        corner = _number(given[1])
        if not corner > 0.0:
            raise FormulaError(f"lp(signal, corner): a corner of {corner:g} Hz is none; above 0")
        return _LowPass(_build(given[0]), corner)
    if name in FUNCTIONS:
        raise FormulaError(f"{name}(): {len(given)} arguments; lp and min, max, atan2 take two")
    raise FormulaError(f"no function {name!r}; there are {', '.join(FUNCTIONS)}")


def _number(node: ast.expr) -> float:
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        try:
            return float(node.value)  # type: ignore[arg-type]
        except OverflowError:
            raise FormulaError("a number is too large") from None
    raise FormulaError(f"lp(signal, corner): {ast.unparse(node)!r} is no number in Hz")


def _quiet(work: Callable[..., Floats], *values: Floats) -> Floats:
    """The result of ``work``; where it is undefined it is NaN, which is drawn as a gap."""
    with np.errstate(all="ignore"):
        return work(*values)


class _Derivative:
    """Backward difference; NaN at the first row."""

    def __init__(self, inner: Step) -> None:
        self._inner = inner
        self._last = (math.nan, math.nan)

    def __call__(self, block: Block) -> Floats:
        y, t = self._inner(block), block[TIME]
        if len(y) == 0:
            return y
        before_t, before_y = self._last
        self._last = (float(t[-1]), float(y[-1]))
        return _quiet(np.divide, np.diff(y, prepend=before_y), np.diff(t, prepend=before_t))


class _LowPass:
    """First-order filter: T y' + y = u, exact for an input that is held; T = 1 / (2 π corner)."""

    def __init__(self, inner: Step, corner_hz: float) -> None:
        self._inner, self._rate = inner, 2.0 * math.pi * corner_hz
        self._t = self._y = math.nan

    def __call__(self, block: Block) -> Floats:
        u, times = self._inner(block), block[TIME]
        out = np.empty_like(u)
        t, y = self._t, self._y
        steps = zip(u.tolist(), times.tolist(), strict=True)
        for k, (value, now) in enumerate(steps):
            if math.isfinite(y) and now > t:
                y += (1.0 - math.exp(-self._rate * (now - t))) * (value - y)
            else:
                y = value
            t, out[k] = now, y
        self._t, self._y = t, y
        return out


def _unit(node: ast.AST, units: Mapping[str, str]) -> str | None:
    """The unit of an expression where it follows simply from those of its signals; else None."""
    name = _signal(node)
    if name is not None:
        return units.get(name)
    if isinstance(node, ast.UnaryOp):
        return _unit(node.operand, units)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
        left, right = _unit(node.left, units), _unit(node.right, units)
        return left if left == right else None
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
        if isinstance(node.right, ast.Constant):
            return _unit(node.left, units)
        if isinstance(node.left, ast.Constant) and isinstance(node.op, ast.Mult):
            return _unit(node.right, units)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.args:
        inner = _unit(node.args[0], units)
        if node.func.id in ("lp", "abs", "min", "max"):
            return inner
        if node.func.id == "d" and inner:
            return f"{inner}/s"
    return None


def sources(channels: Sequence[Channel]) -> list[str]:
    """The signals that a target must send for these curves, each once."""
    found: dict[str, None] = {}
    for channel in channels:
        if not channel.formula:
            found[channel.name] = None
        else:
            found |= dict.fromkeys(_names(_parse(channel.formula)))
    return list(found)


class Computed:
    """Turns rows of the sources into rows of the curves.

    Parameters
    ----------
    channels : sequence of Channel
        The curves, some of them with a formula.
    append : callable
        ``append(ticks, rows, period_s)`` takes the rows of the curves.
    """

    def __init__(
        self,
        channels: Sequence[Channel],
        append: Callable[[npt.NDArray[np.int64], Floats, float], None],
    ) -> None:
        self._channels, self._append = tuple(channels), append
        self.sources = sources(channels)
        self._last, self._step = -1, 0
        self._begin()

    def _begin(self) -> None:
        self._steps = [_build(_parse(c.formula)) if c.formula else None for c in self._channels]

    def __call__(self, ticks: npt.NDArray[np.int64], rows: Floats, period_s: float) -> None:
        """Take rows of the sources, newest last."""
        fresh = ticks > self._last if len(ticks) and ticks[-1] > self._last else slice(None)
        ticks, rows = ticks[fresh], rows[fresh]
        if len(ticks) == 0:
            return
        first = int(ticks[0])
        if first <= self._last or (self._step and first - self._last > 2 * self._step):
            self._begin()  # rows are missing, or the target began anew: no state outlives that
        self._step = int(ticks[1] - ticks[0]) if len(ticks) > 1 else self._step
        self._last = int(ticks[-1])
        block: dict[str, Floats] = {name: rows[:, k] for k, name in enumerate(self.sources)}
        block[TIME] = np.asarray(ticks * period_s, dtype=np.float64)
        columns = [
            rows[:, self.sources.index(channel.name)] if step is None else step(block)
            for channel, step in zip(self._channels, self._steps, strict=True)
        ]
        self._append(ticks, np.stack(columns, axis=1), period_s)
