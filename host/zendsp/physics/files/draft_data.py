"""Recognises the columns of a recording, and estimates first numbers of a joint."""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zendsp.errors import RecordingError
from zendsp.physics.kernel.signals import ALL_OF_RANGE, find_resolution, is_set_value
from zendsp.physics.kernel.smooth import polynomial
from zendsp.recording import Recording, Table
from zendsp.recording.notes import JointNote
from zendsp.recording.roles import Role, role_of
from zendsp_protocol.texts import units_of

CURRENT_LOOP_S = 1.6e-4  # of the drives of a MuJoCo machine (docs/machines_mujoco.md)
Array = npt.NDArray[np.float64]
WINDOW_S = 0.05  # over which position is smoothed for a first idea of speed and acceleration
EXPLAINS = 0.3  # share of the command's variance: below that no first idea is given
MATTERS = 0.02  # share that gravity must add
WHOLE = 0.02  # of a count: so near to a whole number of counts a turn is one
FINE = 0.1  # of a count: where the count is known no better, any number would be whole
ALIKE = 0.05  # two speeds, or a command and its measurement, that differ by less are the same
# words of a position behind a spring, and how German words of one begin or end
LOAD = ("load", "link", "output", "arm", "scale", "abtrieb")
LOAD_PARTS = re.compile(r"ma(?:ß|ss)stab$|^(?:last|abtriebs?|schlitten)(?:position|lage|winkel)")
# of several columns that could be the command
PREFERRED = ("tau", "torque", "effort", "force", "u")
ASKED = {"cmd", "command", "commanded", "total"}
# of a torque that is only a part of the command
PARTS = {
    "computed", "calc", "model", "ff", "feedforward", "fb", "feedback", "fric", "friction", "comp",
    "compensation", "dyn", "dynamics", "grav", "gravity",
}


@dataclass(frozen=True)
class Group:
    """Columns that belong together, one a joint, or one array of all joints."""

    names: tuple[str, ...]
    values: Array  # (n, joints)
    unit: str  # of all columns, or one for each: "m, rad"

    @property
    def is_torque(self) -> bool:
        """Whether its unit is that of a torque or a force."""
        return all(unit in ("N m", "Nm", "N") for unit in self.unit.split(", "))

    @property
    def spec(self) -> str:
        """As ``[columns]`` has it."""
        return json.dumps(
            self.names[0] if len(self.names) == 1 else list(self.names), ensure_ascii=False
        )


# what a program that fits any machine calls rad is m where its joints slide
SLIDES = {"rad": "m", "rad/s": "m/s", "N m": "N", "Nm": "N"}


def sliding(groups: Mapping[Role, list[Group]], slides: list[bool]) -> dict[Role, list[Group]]:
    """The same columns, each joint's in the unit of one that slides or turns."""

    def of(group: Group) -> Group:
        if group.values.shape[1] != len(slides):
            return group
        units = [
            SLIDES.get(unit, unit) if there else unit
            for unit, there in zip(units_of(group.unit, len(slides)), slides, strict=True)
        ]
        return replace(group, unit=one_or_each(units))

    return {role: [of(group) for group in found] for role, found in groups.items()}


def one_or_each(units: Sequence[str]) -> str:
    """The unit of all, or one for each: "m, rad"."""
    return units[0] if len(set(units)) == 1 else ", ".join(units)


def groups_of(table: Table) -> dict[Role, list[Group]]:
    """The columns of a table by their role, those that differ only in a number together."""
    found: dict[tuple[Role, str], list[str]] = {}
    for name, values in table.columns.items():
        if np.isfinite(values).any():
            found.setdefault(
                (role_of(name, table.units.get(name, "")), _stem(name, values)), []
            ).append(name)
    groups: dict[Role, list[Group]] = {}
    for (role, _), names in found.items():
        values = np.column_stack([table.columns[n] for n in names])
        units = [table.units.get(n, "") for n in names]
        groups.setdefault(role, []).append(Group(tuple(names), values, one_or_each(units)))
    return groups


def _stem(name: str, values: Array) -> str:
    """What the columns of one quantity share: ``q1``, ``q2``; ``joint_states.elbow.effort``,
    ``joint_states.wrist.effort``, or as PlotJuggler writes them, ``/joint_states/elbow/effort``.
    """
    if values.ndim == 2:
        return name
    parts = _path(name)
    plain = f"{parts[0]}.{parts[-1]}" if len(parts) > 2 else name
    return re.sub(r"\d+", "", plain)


def best_group(groups: dict[Role, list[Group]], role: Role, joints: int = 0) -> Group | None:
    """The group that most probably has this role; with ``joints``, only one that has a column for
    each.
    """
    some = [g for g in groups.get(role, []) if not joints or g.values.shape[1] == joints]
    if role is Role.POSITION:
        some = [g for g in some if not is_behind(g)] or some
        # one that its name says before one of which only the unit does
        return max(
            some, key=lambda g: (g.values.shape[1], role_of(g.names[0]) is role), default=None
        )
    rank = {word: k for k, word in enumerate(PREFERRED)}

    def unlikely(group: Group) -> tuple[bool, bool, bool, bool, int]:
        words = re.findall(r"[a-z]+", group.names[0].lower())
        return (
            not np.nanstd(group.values, axis=0).any(),  # as the effort of a JointState without one
            not PARTS.isdisjoint(words),
            not group.is_torque,
            ASKED.isdisjoint(words),
            min((rank.get(w, 9) for w in words), default=9),
        )

    return min(some, key=unlikely, default=None)


def driven_by(
    groups: dict[Role, list[Group]], position: Group
) -> tuple[dict[Role, list[Group]], Group | None, str]:
    """The columns by role, which of them drives the joints, and a question about it. A command
    without a unit that is the position in its numbers is a set value, where another could drive.
    """
    joints = position.values.shape[1]
    found = [best_group(groups, role, joints) for role in (Role.COMMAND, Role.CURRENT)]
    command, current = found
    if command is None or not _set_value(command, position):
        return groups, command or current, ""
    others = [g for g in groups[Role.COMMAND] if g is not command]
    moved = [*groups.get(Role.REFERENCE, []), command]
    without = {**groups, Role.COMMAND: others, Role.REFERENCE: moved}
    driver = best_group(without, Role.COMMAND, joints) or current
    like = f"{command.names[0]} is all but equal to {position.names[0]}"
    if driver is None:
        asked = "is it a set value? Then name here what drives the joint, a torque or a current"
        return groups, command, f"{like}: {asked}"
    taken = f"it is taken for its set value, and {driver.names[0]} for the command: is that so?"
    return without, driver, f"{like}: {taken}"


def _set_value(command: Group, position: Group) -> bool:
    """Whether a command without a unit is a set value, by its numbers."""
    whole = np.isfinite(command.values).all(axis=1) & np.isfinite(position.values).all(axis=1)
    both = zip(command.values[whole].T, position.values[whole].T, strict=True)
    return bool(whole.any() and not command.unit and all(is_set_value(u, y) for u, y in both))


def in_order(group: Group, position: Group) -> Group:
    """The columns of a group in the order of the position's joints, where names of both say which
    joint they are of: JointStates name theirs in any order.
    """
    wanted, there = ([_joint(name) for name in g.names] for g in (position, group))
    if wanted == there or sorted(wanted) != sorted(there) or len(set(there)) < len(there):
        return group
    order = [there.index(joint) for joint in wanted]
    return Group(tuple(group.names[k] for k in order), group.values[:, order], group.unit)


def _path(name: str) -> list[str]:
    """The steps of a name that is a path; where points part them, a topic keeps its slashes."""
    return name.split(".") if "." in name else name.strip("/").split("/")


def _joint(name: str) -> str:
    return ".".join(_path(name)[1:-1])


def unbroken(clock: Group | None, rows: int) -> slice:
    """The longest stretch of a recording in which no row is missing."""
    if clock is None:
        return slice(rows)
    steps = np.diff(clock.values[:, 0])
    return _longest(np.append(steps > 1.5 * np.median(steps), True))


def _longest(last: npt.NDArray[np.bool_]) -> slice:
    """The longest stretch between rows that are the last of theirs."""
    ends = np.flatnonzero(last) + 1
    begins = np.concatenate([[0], ends[:-1]])
    longest = int(np.argmax(ends - begins))
    return slice(int(begins[longest]), int(ends[longest]))


def is_behind(group: Group) -> bool:
    """Whether the first column's name says that it is the load's, behind the transmission."""
    words = set(re.findall(r"[^\W\d_]+", group.names[0].lower()))
    return bool({*LOAD} & words) or any(LOAD_PARTS.search(word) for word in words)


def why_degrees(position: Group, velocity: Group | None, clock: Group | None) -> str:
    """Return what shows that a position without a unit is in degrees; empty where nothing does.

    Its size does not: a joint that swings by 1.5 may swing by rad or by degrees. A velocity in
    rad/s does. So do counts, where one turn is a whole number of them if it has 360 units, and none
    if it has 2 pi, unless the steps are only those of the digits that were written.
    """
    if velocity is not None and clock is not None:
        ratio = _moves(position, velocity, clock)
        if abs(ratio * np.pi / 180.0 - 1.0) < ALIKE:
            return f"it moves {ratio:.1f} times as fast as {velocity.names[0]} says"
        if velocity.unit == "rad/s" and abs(ratio - 1.0) < ALIKE:
            return ""
    steps = [find_resolution(finite(column)) for column in position.values.T]
    counted = (
        s and _whole(360.0 / s) and not _whole(2 * np.pi / s) and not _digits(finite(column), s)
        for s, column in zip(steps, position.values.T, strict=True)
    )
    return f"its steps are 360/{round(360.0 / steps[0])}" if all(counted) else ""


def _whole(turn: float) -> bool:
    """Whether a turn is a whole number of counts; of too many the step is not known well enough."""
    near = WHOLE * max(1.0, turn / 1e4)
    return near < FINE and abs(turn - round(turn)) < near


def _digits(column: Array, step: float) -> bool:
    """Whether a column is as it is because it was written with so many digits."""
    rounded = np.round(column, max(0, math.ceil(-math.log10(step) - 0.01)))
    return bool(np.abs(column - rounded).max() < 0.01 * step)


def _moves(position: Group, velocity: Group, clock: Group) -> float:
    """How many times as fast positions move as the velocities beside them say; NaN where they do
    not move together.
    """
    steps = np.diff(clock.values[:, 0])[:, None]
    moved, said = np.diff(position.values, axis=0), velocity.values[:-1] * steps
    good = np.isfinite(moved + said) & (steps > 0) & (steps < 1.5 * np.median(steps))
    moved, said = (np.where(good, x, 0.0) for x in (moved, said))
    # as sums over a tenth of a second: single steps are those of the encoder
    over = max(1, round(2 * WINDOW_S / max(float(np.median(steps)), 1e-9)))
    rows = len(moved) // over * over
    if rows < 10 * over:
        return math.nan
    moved, said = (x[:rows].reshape(-1, over, x.shape[1]).sum(axis=1) for x in (moved, said))
    product = float((moved * said).sum())
    sizes = float((moved**2).sum()), float((said**2).sum())
    together = product > 0.9 * math.sqrt(sizes[0] * sizes[1])
    return product / sizes[1] if together and sizes[1] > 0 else math.nan


def finite(column: Array) -> Array:
    """The numbers of a column that are finite."""
    kept: Array = column[np.isfinite(column)]
    return kept


@dataclass(frozen=True)
class Machine:
    """What zendsp's own recording says of the machine, beside its rows.

    Attributes
    ----------
    name : str
    model : str
        Path of the MuJoCo model that the target simulates; empty: there is none, or it is not here.
    joints : tuple of JointNote
    period : float
        Of the loop, s: the rows of a decimated recording are further apart.
    lag : float
        Time constant of the drives, s; 0 where it is not known.
    """

    name: str
    model: str
    joints: tuple[JointNote, ...]
    period: float
    lag: float

    @property
    def slides(self) -> list[bool]:
        """Whether each joint slides, or turns."""
        return [joint["unit"] == "m" for joint in self.joints]

    @property
    def limits(self) -> list[float]:
        """Largest torque of each joint, N m or N; empty where one has none."""
        found = [joint["torque_max"] for joint in self.joints]
        limits = [limit for limit in found if limit is not None]
        return limits if len(limits) == len(found) else []


def machine_of(path: Path, folder: Path) -> Machine | None:
    """Return the machine of a recording that zendsp made; None for another's.

    Parameters
    ----------
    path : Path
        Of the recording.
    folder : Path
        Where the model file will stand: a MuJoCo model below it is named from there.
    """
    try:
        recording = Recording.load(path)
    except RecordingError:
        return None
    about = recording.extra.get("machine")
    if not isinstance(about, Mapping):
        return None
    options = dict(option.partition("=")[::2] for option in about["options"])
    lag = 0.0
    if about["model"] and options.get("ideal", "0") == "0":
        lag = float(options.get("current_loop", CURRENT_LOOP_S))
    file = Path(about["model"])
    here = about["model"] and file.is_file() and find_spec("mujoco") is not None
    below = here and file.resolve().is_relative_to(folder.resolve())
    return Machine(
        name=about["name"],
        model=(os.path.relpath(file, folder) if below else str(file)) if here else "",
        joints=tuple(about["joints"]),
        period=recording.sample_time / recording.decimation,
        lag=lag,
    )


@dataclass(frozen=True)
class Idea:
    """Of one joint: inertia, gravity, and the share of the command that they explain."""

    inertia: float
    gravity: float
    share: float


def _put_together(q: Array) -> Array:
    """A position without steps of nearly all its span: no motion is so fast, but an angle or a
    counter that begins anew falls by all of its range.
    """
    step = np.diff(q)
    anew = np.abs(step) > ALL_OF_RANGE * np.ptp(q)
    if not anew.any() or anew.all():
        return q
    rows = np.arange(len(step))
    step[anew] = np.interp(rows[anew], rows[~anew], step[~anew])
    together: Array = q[0] + np.append(0.0, np.cumsum(step))
    return together


def first_idea(q: Array, u: Array, step: float, linear: bool) -> Idea | None:
    """Inertia and gravity by least squares beside friction and a bias, of the longest stretch of
    finite numbers; None where the command is hardly explained.
    """
    window = max(5, 2 * round(WINDOW_S / step / 2) + 1)
    lacking = np.append(~np.isfinite(q + u), True)  # each is the last row of its stretch
    part = _longest(lacking)
    q, u = (x[part.start : part.stop - 1] for x in (q, u))
    q = _put_together(q)
    if len(q) < 4 * window or np.std(u) == 0:
        return None
    speed, acceleration = (polynomial(q, window, 3, d, step) for d in (1, 2))
    smooth = polynomial(u, window, 3)
    moving = np.abs(speed) > 0.02 * np.max(np.abs(speed))
    base = [acceleration, speed, np.sign(speed), np.ones_like(q)]

    def fit(columns: list[Array]) -> tuple[Array, float]:
        a, b = np.column_stack(columns)[moving], smooth[moving]
        x: Array = np.linalg.lstsq(a, b, rcond=None)[0]
        return x, 1.0 - float(np.var(b - a @ x) / max(np.var(b), 1e-300))

    if np.count_nonzero(moving) < 10 * len(base):
        return None
    x, share = fit(base)
    gravity = 0.0
    if not linear:
        with_gravity, more = fit([*base, np.sin(q)])
        # swinging about q = 0, gravity looks like a negative inertia
        if (more - share > MATTERS or x[0] <= 0) and with_gravity[4] > 0:
            x, share, gravity = with_gravity, more, float(with_gravity[4])
    return Idea(float(x[0]), gravity, share) if share > EXPLAINS and x[0] > 0 else None
