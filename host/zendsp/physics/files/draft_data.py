"""What the columns of a recording are, and what they say of a joint at first sight."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.physics.kernel.signals import find_resolution
from zendsp.recording import Table
from zendsp.recording.roles import Role, role_of

Array = npt.NDArray[np.float64]
WHOLE = 0.02  # of a count: so near to a whole number of counts a turn is one
LOAD = ("load", "link", "output", "arm")  # words of a position behind a spring
# of several columns that could be the command
PREFERRED = ("tau", "torque", "effort", "force", "u")


@dataclass(frozen=True)
class Group:
    """Columns that belong together, one a joint, or one array of all joints."""

    names: tuple[str, ...]
    values: Array  # (n, joints)
    unit: str

    @property
    def spec(self) -> str:
        """As ``[columns]`` has it."""
        return json.dumps(
            self.names[0] if len(self.names) == 1 else list(self.names), ensure_ascii=False
        )


def groups_of(table: Table) -> dict[Role, list[Group]]:
    found: dict[tuple[Role, str], list[str]] = {}
    for name, values in table.columns.items():
        if np.isfinite(values).any():
            found.setdefault(
                (role_of(name, table.units.get(name, "")), _stem(name, values)), []
            ).append(name)
    groups: dict[Role, list[Group]] = {}
    for (role, _), names in found.items():
        values = np.column_stack([table.columns[n] for n in names])
        groups.setdefault(role, []).append(
            Group(tuple(names), values, table.units.get(names[0], ""))
        )
    return groups


def _stem(name: str, values: Array) -> str:
    """What the columns of one quantity share: ``q1``, ``q2``; ``joint_states.elbow.effort``,
    ``joint_states.wrist.effort``.
    """
    if values.ndim == 2:
        return name
    parts = name.split(".")
    plain = f"{parts[0]}.{parts[-1]}" if len(parts) > 2 else name
    return re.sub(r"\d+", "", plain)


def best_group(groups: dict[Role, list[Group]], role: Role, joints: int = 0) -> Group | None:
    """The group that most probably has this role; with ``joints``, only one that has a column for
    each.
    """
    some = [g for g in groups.get(role, []) if not joints or g.values.shape[1] == joints]
    if role is Role.POSITION:
        some = [g for g in some if not is_behind(g)] or some
        return max(some, key=lambda g: g.values.shape[1], default=None)
    rank = {word: k for k, word in enumerate(PREFERRED)}

    def unlikely(group: Group) -> tuple[int, int]:
        words = re.findall(r"[a-z]+", group.names[0].lower())
        return (
            group.unit not in ("N m", "Nm", "N"),
            min((rank.get(w, 9) for w in words), default=9),
        )

    return min(some, key=unlikely, default=None)


def is_behind(group: Group) -> bool:
    return bool({*LOAD} & set(re.findall(r"[a-z]+", group.names[0].lower())))


def like_degrees(position: Group) -> bool:
    """Whether one turn is a whole number of steps where it has 360 units, and none where it has
    2 pi.
    """

    def whole(turn: float) -> bool:
        return abs(turn - round(turn)) < WHOLE * max(1.0, turn / 1e4)

    steps = [find_resolution(finite(column)) for column in position.values.T]
    return all(s and whole(360.0 / s) and not whole(2 * np.pi / s) for s in steps)


def finite(column: Array) -> Array:
    kept: Array = column[np.isfinite(column)]
    return kept


@dataclass(frozen=True)
class _Idea:
    inertia: float
    gravity: float
    share: float
