"""A model file as the simulator's C takes it, and one simulated machine that can be stepped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError
from zendsp.physics.effects import get_effect
from zendsp.physics.model import TREES, Model, Quantity, per_joint
from zendsp.physics.robots.bodies import body_terms, changed, turned_gravity
from zendsp.physics.robots.robot import robot_tree
from zendsp.physics.simulation.native import (
    MAX_JOINTS,
    MAX_PARAMETERS,
    TREE_ROW,
    SimulatorLibrary,
    simulator_library,
)
from zendsp.physics.term_numbers import added_inertia, kernel_model
from zendsp.tree import GRAVITY, Body
from zendsp_protocol.texts import counted

Array = npt.NDArray[np.float64]

KINDS = {"rotary": 0, "linear": 0, "planar2r": 1, "urdf": 2, "mjcf": 2}
ASIDE = "p3_angle"  # rad, in the mechanism: see ``aside_of``
TOGETHER = 10.0  # times lighter than alone, of joints together; `most` of mujoco_model.h
INNER = 4  # integration steps per sample where nothing else is asked for


def _rows(bodies: Sequence[Body]) -> Array:
    rows = np.zeros((len(bodies), TREE_ROW))
    for row, body in zip(rows, bodies, strict=True):
        row[0], row[1] = body.parent, body.slides
        row[2:5] = body.axis
        row[5:14], row[14:17] = body.rotation.ravel(), body.place
        row[17], row[18:21] = body.mass, body.com
        I = body.inertia
        row[21:27] = I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]
    return rows


def tree_of(model: Model) -> tuple[Array, Array]:
    """The links of a robot's file, with its payloads and what the model knows to be wrong in it.

    Parameters
    ----------
    model : Model
        Of kind "urdf" or "mjcf".

    Returns
    -------
    rows : ndarray, shape (joints, 28)
        As tree.h describes them.
    gravity : ndarray, shape (3,), m/s^2

    Raises
    ------
    ModelError
        No such file, one that cannot be taken over, or parts that the simulator does not have.
    """
    bodies, gravity = robot_tree(model)
    if len(bodies) > MAX_JOINTS:
        raise ModelError(
            f"{model.file}: has {len(bodies)} joints; the simulator takes at most {MAX_JOINTS}"
        )
    if lifted := [b.name for b in bodies if b.lifted]:
        raise ModelError(
            f"{model.file}: gravcomp of body {lifted[0]!r}: the simulator has no compensated"
            " weight; set gravcomp to 0"
        )
    if model.robot.servos:
        raise ModelError(
            f"{model.file}: its servos are not simulated: state [actuator] gain, then a command is"
            " a torque"
        )
    terms = body_terms(model)
    return _rows(changed(bodies, terms)), turned_gravity(gravity, terms).copy()


def aside_of(model: Model) -> float:
    """The angle at which the second link of a ``planar2r`` carries what its p3 is, rad from its
    line: p3 cos(q2 + angle).
    """
    return model.mechanism.get(ASIDE, (Quantity(0.0),))[0].value


def with_bodies(model: Model) -> Model:
    """The model with its payloads taken into the parameters of its mechanism, where its kind has no
    links of its own.

    Raises
    ------
    ModelError
        A body that these parameters cannot express.
    """
    if model.kind in TREES or not (terms := body_terms(model)):
        return model
    mechanism = {key: list(items) for key, items in model.mechanism.items()}

    def add(key: str, joint: int, value: float) -> None:
        items = mechanism.setdefault(key, [Quantity(0.0, free=False)])
        if len(items) == 1:
            items *= model.joints if model.kind == "rotary" else 1
        at = joint - 1 if len(items) > 1 else 0
        items[at] = replace(items[at], value=items[at].value + value)

    for term in terms:
        mass, x, y = (term.value(key) for key in ("mass", "com_x", "com_y"))
        about_axis = mass * (x**2 + y**2) + term.value("inertia")
        known = model.kind == "planar2r" or (model.kind == "rotary" and y == 0.0)
        if term.effect != "payload" or not known:
            raise ModelError(
                f"{model.name}: {term.effect} of joint {term.joint} with com_y = {y:g} m cannot be"
                f" simulated with kind = {model.kind!r}: use a payload with com_y = 0, or a URDF"
            )
        if model.kind == "rotary":
            add("inertia", term.joint, about_axis)
            if (
                per_joint(
                    tuple(q.value for q in model.mechanism.get("gravity", ())), term.joint, 0.0
                )
                != 0
            ):
                add("gravity", term.joint, -GRAVITY[2] * mass * x)
            continue
        l1 = per_joint(tuple(q.value for q in model.mechanism.get("l1", ())), 1, 0.0)
        if term.joint == 1:
            add("p1", 1, about_axis)
            continue
        for key, value in (
            ("p1", mass * l1**2 + about_axis),
            ("p2", about_axis),
            ("p3", mass * l1 * x),
            (ASIDE, mass * l1 * y),
        ):
            add(key, 1, value)
    along, aside = (mechanism.get(key, [Quantity(0.0)])[0].value for key in ("p3", ASIDE))
    if aside:
        mechanism["p3"] = [replace(mechanism["p3"][0], value=math.hypot(along, aside))]
        mechanism[ASIDE] = [Quantity(math.atan2(aside, along), free=False)]
    kept = tuple(t for t in model.terms if not any(t is term for term in terms))
    return replace(model, mechanism={k: tuple(v) for k, v in mechanism.items()}, terms=kept)


def joint_count(model: Model) -> int:
    """Number of joints of a model, also of a robot's file whose columns name none."""
    return len(robot_tree(model)[0]) if model.kind in TREES else model.joints


def _mechanism(model: Model, key: str, joints: int) -> list[float]:
    items = model.mechanism.get(key, ())
    return [per_joint(tuple(q.value for q in items), j + 1, 0.0) for j in range(joints)]


def _square(rows: tuple[tuple[float, ...], ...], n: int, what: str) -> Array:
    if not rows:
        return np.eye(n)
    matrix = np.array(rows, dtype=np.float64)
    if matrix.shape != (n, n):
        raise ModelError(
            f"{what} matrix is {matrix.shape[0]} x {matrix.shape[1]}; the machine has"
            f" {counted(n, 'joint')}"
        )
    return matrix


class Plant:
    """One simulated machine, stepped sample by sample.

    Parameters
    ----------
    model : Model
    samples : int
        How many samples it will live.
    inner : int
        Integration steps per sample.
    position, velocity : array_like, shape (joints,), optional
        Where it starts, rad or m, and rad/s or m/s; 0 where absent.
    temperature : array_like, shape (samples,), or float, optional
        Of the machine, °C; the last one stays. 20 where absent.

    Raises
    ------
    ModelError
        A model that the simulator cannot take: kind "python", no sample time, too many joints.
    """

    def __init__(
        self,
        model: Model,
        samples: int,
        *,
        inner: int = INNER,
        position: npt.ArrayLike | None = None,
        velocity: npt.ArrayLike | None = None,
        temperature: npt.ArrayLike | None = None,
    ) -> None:
        if model.kind not in KINDS:
            raise ModelError(
                f"{model.name}: kind = {model.kind!r} is simulated by its own function; expected"
                f" {', '.join(KINDS)}"
            )
        model = with_bodies(model)
        if not model.sample_time:
            raise ModelError(f"{model.name}: lacks sample_time, which a simulation needs")
        self.model = model
        self.samples = int(samples)
        self.period = float(model.sample_time)
        self.inner = int(inner)
        self.native: SimulatorLibrary = simulator_library()
        self._keep: list[Any] = []
        self.joints = joint_count(model)
        if self.joints > MAX_JOINTS:
            raise ModelError(
                f"{model.name}: {self.joints} joints; the simulator takes at most {MAX_JOINTS}"
            )
        c = self.native.ffi.new("sim_config *")
        self._fill(c, position, velocity)
        warmth = np.atleast_1d(
            np.asarray([] if temperature is None else temperature, dtype=np.float64)
        )
        if warmth.ndim != 1 or not np.isfinite(warmth).all():
            raise ModelError(
                f"{model.name}: temperature has shape {warmth.shape}; expected finite numbers, one"
                " a sample"
            )
        c.temperature, c.temperatures = self._pointer(warmth), len(warmth)
        self.config = c
        pointer = self.native.lib.sim_new(c, self.samples)
        if pointer == self.native.ffi.NULL:
            raise ModelError(f"{model.name}: no memory for {samples} samples")
        self.pointer = self.native.ffi.gc(pointer, self.native.lib.sim_free)

    def _fill(self, c: Any, position: npt.ArrayLike | None, velocity: npt.ArrayLike | None) -> None:
        model, n = self.model, self.joints
        c.joints, c.kind, c.inner, c.period = n, KINDS[model.kind], self.inner, self.period
        c.load_sensor = int(model.sensor.side == "load")
        c.delay = model.actuator.delay
        c.hold = max(1, round((model.actuator.hold or self.period) / self.period))
        if model.kind in TREES:
            rows, gravity = tree_of(model)
            c.tree = self._pointer(rows)
            c.gravity = gravity.tolist()
        elif model.kind == "planar2r":
            c.p1, c.p2, c.p3 = (model.mechanism[k][0].value for k in ("p1", "p2", "p3"))
            c.p3_angle = aside_of(model)
        else:
            c.inertia = _mechanism(model, "inertia" if model.kind == "rotary" else "mass", n)
            c.weight = _mechanism(model, "gravity", n) if model.kind == "rotary" else [0.0] * n
        for j in range(n):
            c.gain[j] = per_joint(model.actuator.gain, j + 1, 1.0)
            c.limit[j] = per_joint(model.actuator.limit, j + 1, 0.0)
            c.resolution[j] = per_joint(model.sensor.resolution, j + 1, 0.0)
            c.sensor_offset[j] = per_joint(model.sensor.offset, j + 1, 0.0)
        for name, start in (("q0", position), ("qd0", velocity)):
            values = (
                np.zeros(n)
                if start is None
                else np.broadcast_to(np.asarray(start, dtype=np.float64), (n,))
            )
            setattr(c, name, values.tolist())
        c.command_matrix = _square(model.actuator.matrix, n, "[actuator]").ravel().tolist()
        c.sensor_matrix = (
            np.linalg.inv(_square(model.sensor.matrix, n, "[sensor]")).ravel().tolist()
        )
        self._effects(c)

    def _effects(self, c: Any) -> None:
        bodies = body_terms(self.model)
        own = (t for t in kernel_model(self.model).terms if t not in bodies)
        terms = sorted(own, key=lambda term: term.joint)
        table = np.zeros((max(1, len(terms)), MAX_PARAMETERS))
        kinds = np.zeros(max(1, len(terms)), np.int32)
        joints = np.zeros(max(1, len(terms)), np.int32)
        for i, term in enumerate(terms):
            kinds[i], joints[i] = self.native.index[term.effect], term.joint - 1
            for k, parameter in enumerate(get_effect(term.effect).parameters):
                value = term.value(parameter.name, parameter.default or 0.0)
                if parameter.size == "joint":
                    if not 1 <= value <= self.joints:
                        raise ModelError(
                            f"{self.model.name}: {term.effect} {parameter.name} = {value:g};"
                            f" expected 1 … {self.joints}"
                        )
                    value -= 1
                table[i, k] = value
        c.effects = len(terms)
        c.effect = self._pointer(kinds)
        c.effect_joint = self._pointer(joints)
        c.effect_p = self._pointer(table)

    def _pointer(self, array: npt.NDArray[Any]) -> Any:
        array = np.ascontiguousarray(array)
        self._keep.append(array)
        return self.native.ints(array) if array.dtype == np.int32 else self.native.doubles(array)

    def inertia(self) -> Array:
        """What each joint turns while the others stand, shape (joints,), kg m^2 or kg: the diagonal
        of the mass matrix M with all joints at 0, rotors in it.

        It is less where joints together are so much lighter than alone that a loop tuned by it
        would not be damped: by what the largest eigenvalue of M^-1 diag(M) exceeds ``TOGETHER``.
        Machines say the same (`JOINT_INERTIA` of isr.h).
        """
        M, n, c = np.zeros((self.joints, self.joints)), self.joints, self.config
        zero, doubles = np.zeros(n), self.native.doubles
        if self.model.kind in TREES:
            gravity = np.array(list(c.gravity))
            self.native.lib.sim_tree(
                n, c.tree, doubles(gravity), *(doubles(zero),) * 3, doubles(np.zeros(n)), doubles(M)
            )
        elif self.model.kind == "planar2r":
            across = c.p3 * math.cos(c.p3_angle)
            M[:] = [[c.p1 + 2.0 * across, c.p2 + across], [c.p2 + across, c.p2]]
        else:
            np.fill_diagonal(M, list(c.inertia)[:n])
        M[np.diag_indices(n)] += [added_inertia(self.model, j + 1) for j in range(n)]
        alone = np.diag(M).copy()
        if (alone <= 0.0).any():
            return np.zeros(n)
        together = np.linalg.eigvals(np.linalg.solve(M, np.diag(alone))).real.max()
        return np.asarray(alone * min(1.0, TOGETHER / together))

    def measure(self) -> Array:
        """What the sensors say now, in their own coordinates, shape (joints,)."""
        measured, counts = np.empty(MAX_JOINTS), np.empty(MAX_JOINTS, np.int32)
        self.native.lib.sim_measure(
            self.pointer, self.native.doubles(measured), self.native.ints(counts)
        )
        return measured[: self.joints].copy()

    def recorded_command(self, command: Array) -> Array:
        """The commands (n, joints) as their column holds them: shifted in time where the model says
        so.
        """
        n, out = len(command), command.copy()
        for j in range(self.joints):
            rows = float(self.native.lib.sim_column_late(self.pointer, j)) / self.period
            if rows:
                more = int(abs(rows)) + 1  # rows before the first and after the last, like these
                total = np.r_[0.0, np.cumsum(np.pad(command[:, j], more, mode="edge"))]
                out[:, j] = np.diff(
                    np.interp(np.arange(n + 1) + more - rows, np.arange(n + 2 * more + 1), total)
                )
        return out

    def truth(self) -> tuple[Array, Array, Array]:
        """Position, speed, and torque of the last sample, each (joints,)."""
        out = np.empty((3, MAX_JOINTS))
        self.native.lib.sim_truth(self.pointer, *(self.native.doubles(row) for row in out))
        q, qd, torque = out[:, : self.joints].copy()
        return q, qd, torque

    def advance(self, command: npt.ArrayLike) -> bool:
        """Let one sample pass under a command (joints,); False where the motion ran away or its
        samples are used up.
        """
        u = np.ascontiguousarray(
            np.broadcast_to(np.asarray(command, dtype=np.float64), (self.joints,))
        )
        return int(self.native.lib.sim_advance(self.pointer, self.native.doubles(u))) == 0
