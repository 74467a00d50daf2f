"""One recording in joint coordinates, and the three parts that a diagnosis cuts its data into."""

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
    # (joints,): what a filter or averaging leaves of the quantiser's noise, however still a joint
    # stands
    least_noise: Array | None = None
    # (joints,): RMS of what the command does beside the lines from row to row; None: it is held
    between: Array | None = None
    whole: str = ""  # name of the recording that this is a part of; empty: it is no part
    origin: float = 0.0  # s: where the time of what changes with time begins, for all recordings

    def part(self, start: int, stop: int, name: str) -> Signals:
        """Rows start … stop - 1 as a recording of their own."""
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
    """The three parts of the data: what models are fitted to, what choices are made by, and what
    neither has touched.
    """

    fit: Data
    choose: Data
    test: Data

    @property
    def each(self) -> tuple[Data, ...]:
        """The different parts."""
        return tuple({id(part): part for part in (self.fit, self.choose, self.test)}.values())

    @property
    def all(self) -> Data:
        """Everything."""
        return replace(self.fit, records=tuple(rec for part in self.each for rec in part.records))

    @property
    def held(self) -> Data:
        """Everything that no model is fitted to."""
        if self.choose is self.test:
            return self.test
        return replace(self.test, records=(*self.choose.records, *self.test.records))


def with_same_columns(
    signals: Sequence[Signals], others: Sequence[Signals]
) -> tuple[list[Signals], list[Signals]]:
    """The recordings with those optional columns that all of them have."""
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
    """A note for each effect that a recording lacks a column for which the model names."""
    notes = []
    for effect in library().values():
        for role in effect.reads:
            lacking = [s.name for s in signals if role not in s.extra]
            if lacking and role in model.columns:
                where = f"{', '.join(lacking)}: no column of {role}"
                notes.append(f"{effect.name} was not considered: {where}")
    return notes
