"""One recording in joint coordinates, and the three parts of a diagnosis' data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from zendsp.physics.calibration.fit import Data
from zendsp.physics.effects import library
from zendsp.physics.model import Model

Array = npt.NDArray[np.float64]

MIN_SAMPLES = 300


@dataclass(frozen=True)
class Signals:
    """One recording in joint coordinates: arrays (n, joints), SI; ``notes`` say what was done to
    the data.
    """

    name: str
    time: Array
    sample_time: float
    position: Array
    command: Array  # torque or command units, after the actuator's matrix
    reference: Array | None
    resolution: Array  # (joints,)
    notes: tuple[str, ...] = ()
    extra: dict[str, Array] = field(default_factory=dict)
    raw: Signals | None = None  # before averaging down, where that was done
    # (joints,): quantisation noise that remains after a filter or averaging, even at rest
    least_noise: Array | None = None
    # (joints,): RMS of white noise that moves a joint as the command about the lines from row to
    # row does; None: it is held
    between: Array | None = None
    whole: str = ""  # name of the recording of which this is a part; empty if of none
    unit_stated: bool = False  # whether the heads of the positions state their unit
    origin: float = 0.0  # s: zero of time for effects over time, for all recordings

    def part(self, start: int, stop: int, name: str) -> Signals:
        """Rows start … stop - 1 as a separate recording."""
        cut = slice(start, stop)
        return replace(
            self,
            name=name,
            whole=self.whole or self.name,
            time=self.time[cut],
            position=self.position[cut],
            command=self.command[cut],
            reference=None if self.reference is None else self.reference[cut],
            extra={key: value[cut] for key, value in self.extra.items()},
            raw=None,
        )


@dataclass(frozen=True)
class Parts:
    """The three parts of the data: to fit models to, to choose by, and to test on, untouched by
    both.
    """

    fit: Data
    choose: Data
    test: Data

    @property
    def each(self) -> tuple[Data, ...]:
        """The distinct parts."""
        return tuple({id(part): part for part in (self.fit, self.choose, self.test)}.values())

    @property
    def all(self) -> Data:
        """The recordings of all parts."""
        return replace(self.fit, records=tuple(rec for part in self.each for rec in part.records))

    @property
    def held(self) -> Data:
        """The recordings to which no model is fitted."""
        if self.choose is self.test:
            return self.test
        return replace(self.test, records=(*self.choose.records, *self.test.records))

    @property
    def undriven(self) -> tuple[int, ...]:
        """The joints, from 1, that nothing drives: their command is zero throughout."""
        joints = enumerate(zip(*self.all.records, strict=True), 1)
        return tuple(j for j, own in joints if not any(np.any(r.command) for r in own))


def with_same_columns(
    signals: Sequence[Signals], others: Sequence[Signals]
) -> tuple[list[Signals], list[Signals]]:
    """The recordings with only those optional columns that all of them have."""
    all_of_them = (*signals, *others)
    roles = {
        role for s in all_of_them for role in s.extra if all(role in x.extra for x in all_of_them)
    }

    def kept(s: Signals) -> Signals:
        return replace(s, extra={role: values for role, values in s.extra.items() if role in roles})

    return [kept(s) for s in signals], [kept(s) for s in others]


def joint_columns(signals: Signals, joint: int) -> dict[str, Array]:
    """The optional columns that one joint (from 0) has, by their role, (n,) each."""
    return {
        role: np.ascontiguousarray(values[:, joint])
        for role, values in signals.extra.items()
        if np.isfinite(values[:, joint]).all()
    }


def unused_effects(signals: Sequence[Signals], model: Model) -> list[str]:
    """A note for each effect without its column, which the model names and a recording lacks."""
    notes = []
    for effect in library().values():
        for role in effect.reads:
            lacking = [s.name for s in signals if role not in s.extra]
            if lacking and role in model.columns:
                where = f"{', '.join(lacking)}: no column of {role}"
                notes.append(f"{effect.name} was not considered: {where}")
    return notes
