"""The torques of bodies at the joints, linear in ten numbers of each link (Atkeson, An, Hollerbach
1986).

The numbers of a link are its mass m, first moment h = m c and inertia I about the link's origin,
all in the link's frame. With the spin w, its rate wd and the acceleration a of the origin less
gravity, the link needs

    force  = m a + wd x h + w x (w x h)          moment = h x a + I wd + w x (I w)

and joint j bears what of it acts along its own screw. Effects of site "body" change these numbers,
or gravity.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError
from zendsp.physics.effects.catalogue import at_site
from zendsp.physics.model import TREES, Model, Term, per_joint
from zendsp.physics.robots.rigid import SMALL
from zendsp.physics.robots.robot import robot_tree
from zendsp.tree import GRAVITY, Body, LinkMotion, about, cross, into, inverse_dynamics, link_motion

Array = npt.NDArray[np.float64]

NUMBERS = ("mass", "h_x", "h_y", "h_z", "ixx", "iyy", "izz", "ixy", "ixz", "iyz")
_ONE = np.eye(3)
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_ROWS, _COLUMNS = np.transpose(_PAIRS)
_ACROSS = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # turns z to the base's x


def numbers_of(mass: float, com: Array, inertia: Array) -> Array:
    """The ten numbers of a body (see ``NUMBERS``) from its inertia about the centre of mass."""
    whole = about(mass, com, inertia)
    return np.array([mass, *(mass * com), *whole[_ROWS, _COLUMNS]])


def body_terms(model: Model) -> tuple[Term, ...]:
    """Terms of a model that change bodies or gravity: all joints that move the body feel them."""
    bodies = at_site("body")
    return tuple([t for t in model.terms if t.effect in bodies])


def turned_gravity(gravity: Array, terms: Sequence[Term]) -> Array:
    """Gravity as ``base_tilt`` turns it: about the base's x axis, then about its y axis."""
    for term in terms:
        if term.effect == "base_tilt":
            x, y = term.value("angle_x"), term.value("angle_y")
            about_x = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
            about_y = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
            gravity = about_y @ about_x @ gravity
    return gravity


def change_of(term: Term, body: Body) -> Array:
    """The change of a link's ten numbers by a ``payload`` or a wrong ``body``, (10,)."""
    com = np.array([term.value("com_x"), term.value("com_y"), term.value("com_z")])
    given = numbers_of(body.mass, body.com, body.inertia)
    return changed_by(term.effect, (term.value("mass"), com, term.value("inertia")), body, given)


def changed_by(
    effect: str, numbers: tuple[float, Array, float], body: Body, given: Array
) -> Array:
    """The same by an effect's mass, centre of mass and inertia; ``given``: the link's own numbers.

    A wrong mass means another density, so the inertia changes in proportion.
    """
    mass, com, inertia = numbers
    spread = inertia * _ONE
    if effect == "payload":
        return numbers_of(mass, com, spread)
    denser = 1.0 + mass / body.mass if body.mass > 0.0 else 1.0
    return numbers_of(body.mass + mass, body.com + com, denser * body.inertia + spread) - given


def changed(bodies: Sequence[Body], terms: Sequence[Term]) -> list[Body]:
    """The links with their payloads and errors applied.

    Raises
    ------
    ModelError
        A link would have no mass left.
    """
    out = list(bodies)
    for term in terms:
        if term.effect == "base_tilt":
            continue
        body = out[term.joint - 1]
        numbers = numbers_of(body.mass, body.com, body.inertia) + change_of(term, body)
        mass, com = float(numbers[0]), numbers[1:4]
        if mass <= 0.0:
            raise ModelError(
                f"{term.effect} of joint {term.joint}: mass = {term.value('mass'):g} kg leaves a"
                f" link of {body.mass:g} kg with {mass:g} kg; it has to stay above 0"
            )
        com = com / mass
        whole = np.empty((3, 3))
        for (i, j), value in zip(_PAIRS, numbers[4:], strict=True):
            whole[i, j] = whole[j, i] = value
        out[term.joint - 1] = replace(
            body, mass=mass, com=com, inertia=whole - about(mass, com, np.zeros((3, 3)))
        )
    return out


def machine_tree(model: Model) -> tuple[list[Body], Array] | None:
    """Links and gravity of a machine, for bodies to be fixed to; None where its kind has none.

    The links of ``rotary`` and ``planar2r`` bear no mass: their inertia and gravity are parameters
    of the mechanism. Their x axis points along the link, and a rotary joint with gravity hangs down
    at q = 0.
    """
    if model.kind in TREES:
        return robot_tree(model)
    axis, empty = np.array([0.0, 0.0, 1.0]), np.zeros((3, 3))
    bare = Body(-1, False, axis, np.eye(3), np.zeros(3), 0.0, np.zeros(3), empty)
    if model.kind == "planar2r":
        length = _values(model, "l1")[0]
        second = replace(bare, parent=0, place=np.array([length, 0.0, 0.0]), name="link 2")
        return ([replace(bare, name="link 1"), second], np.zeros(3)) if length > 0 else None
    if model.kind == "rotary":
        down = -GRAVITY[2] * np.array([1.0, 0.0, 0.0])
        turns = [np.eye(3) if weight else _ACROSS for weight in _values(model, "gravity")]
        return [replace(bare, rotation=R, name=f"link {j + 1}") for j, R in enumerate(turns)], down
    return None


def _values(model: Model, key: str) -> list[float]:
    """A parameter of the mechanism for each joint; 0 where the model has none."""
    given = tuple(q.value for q in model.mechanism.get(key, ()))
    return [per_joint(given, j + 1, 0.0) for j in range(model.joints)]


@dataclass(frozen=True)
class Change:
    """The inertia and known torque that body terms add to one joint along a record, each (n,)."""

    inertia: Array
    bias: Array


@dataclass(frozen=True)
class Links:
    """The links of a machine along one recording, as its joints feel them; joints and links count
    from 0.
    """

    bodies: tuple[Body, ...]
    gravity: Array
    motion: Array  # (joints, 3, n): q, qd, qdd

    def __reduce__(self) -> tuple[type[Links], tuple[tuple[Body, ...], Array, Array]]:
        """To another process goes what the rest follows from."""
        return Links, (self.bodies, self.gravity, self.motion)

    @cached_property
    def _moved(self) -> LinkMotion:
        q, qd, qdd = (np.ascontiguousarray(self.motion[:, i].T) for i in range(3))
        return link_motion(self.bodies, self.gravity, q, qd, qdd)

    @cached_property
    def _columns(self) -> dict[tuple[int, int], tuple[Array, Array]]:
        return {}

    @cached_property
    def _pulls(self) -> dict[tuple[int, int], Array]:
        return {}

    @cached_property
    def _zeros(self) -> dict[tuple[object, ...], Array]:
        return {}

    @cached_property
    def _weights(self) -> dict[int, Array]:
        return {}

    @cached_property
    def _screws(self) -> dict[tuple[int, int], tuple[Array, Array]]:
        """Turning (3, n) and sliding (3, n) of each link's origin for a unit speed of a joint that
        moves it.
        """
        n, out = self.motion.shape[2], {}
        for k, b in enumerate(self.bodies):
            own = np.repeat(b.axis[:, None], n, axis=1)
            out[k, k] = (np.zeros((3, n)), own) if b.slides else (own, np.zeros((3, n)))
            turn, place = self._moved.turn[k], self._moved.place[k]
            for j in range(k):
                if (j, b.parent) in out:
                    spin, slide = out[j, b.parent]
                    slide = slide + cross(spin, place)
                    out[j, k] = (into(turn, spin), into(turn, slide))
        return out

    def moves(self, joint: int, link: int) -> bool:
        """Whether a joint moves a link."""
        return (joint, link) in self._screws

    def columns(self, joint: int, link: int) -> tuple[Array, Array]:
        """Inertia and torque at the joint per unit of each of a link's ten numbers, (10, n) each.
        """
        key = (joint, link)
        if key not in self._columns:
            turn, slide = self._screws[key]
            moved = self._moved
            w, wd, a = moved.spin[link], moved.spin_rate[link], moved.push[link]
            torque = np.concatenate([
                [_dot(slide, a)],
                cross(slide, wd) + cross(w, cross(w, slide)) + cross(a, turn),
                _products(turn, wd) + _products(cross(turn, w), w),
            ])  # fmt: skip
            inertia = np.concatenate(
                [[_dot(slide, slide)], 2.0 * cross(slide, turn), _products(turn, turn)]
            )
            self._columns[key] = (inertia, torque)
        return self._columns[key]

    def pull(self, joint: int, link: int) -> Array:
        """Torque for a unit of gravity along each axis of the base and each of mass and first
        moment, (3, 4, n).
        """
        key = (joint, link)
        if key not in self._pulls:
            turn, slide = self._screws[key]
            out = np.empty((3, 4, self.motion.shape[2]))
            for axis, down in enumerate(self._base(link)):
                out[axis] = np.concatenate([[-_dot(slide, down)], -cross(down, turn)])
            self._pulls[key] = out
        return self._pulls[key]

    def _base(self, link: int) -> list[Array]:
        """Axes of the base in the link's frame, (3, n) each."""
        axes = [np.repeat(e[:, None], self.motion.shape[2], axis=1) for e in np.eye(3)]
        chain = [link]
        while self.bodies[chain[-1]].parent >= 0:
            chain.append(self.bodies[chain[-1]].parent)
        for k in reversed(chain):
            axes = [into(self._moved.turn[k], v) for v in axes]
        return axes

    def weight(self, joint: int, terms: Sequence[Term] = ()) -> Array:
        """Torque of all links, with their payloads and errors, for a unit of gravity along each
        axis of the base, (3, n).
        """
        if joint not in self._weights:
            total = np.zeros((3, self.motion.shape[2]))
            for k, b in enumerate(self.bodies):
                if self.moves(joint, k) and b.mass > 0:
                    total += np.tensordot([b.mass, *(b.mass * b.com)], self.pull(joint, k), (0, 1))
            self._weights[joint] = total
        weight = self._weights[joint]
        for term in terms:
            if term.effect != "base_tilt" and self.moves(joint, term.joint - 1):
                numbers = change_of(term, self.bodies[term.joint - 1])[:4]
                weight = weight + np.tensordot(numbers, self.pull(joint, term.joint - 1), (0, 1))
        return weight

    def zeros(self, at: Mapping[int, float], terms: Sequence[Term]) -> Array:
        """Torque at each joint per shift of each joint's zero, N m or N per rad, (joints, joints,
        n). ``at``: by joint (from 1) the shift, rad, over which the slope is taken; else a small
        one.
        """
        values = [(t.effect, t.joint, *((k, t.value(k)) for k in t.parameters)) for t in terms]
        key = (tuple(at.items()), tuple(values))
        if key not in self._zeros:
            q, qd, qdd = (np.ascontiguousarray(self.motion[:, i].T) for i in range(3))
            bodies, gravity = changed(self.bodies, terms), turned_gravity(self.gravity, terms)
            here = inverse_dynamics(bodies, gravity, q, qd, qdd)
            out = np.zeros((q.shape[1], q.shape[1], len(q)))
            for k in self.turning:
                there, by = q.copy(), at.get(k + 1, SMALL)
                there[:, k] += by
                out[:, k] = (inverse_dynamics(bodies, gravity, there, qd, qdd) - here).T / by
            self._zeros[key] = out
        return self._zeros[key]

    @property
    def turning(self) -> list[int]:
        """The joints (from 0) that turn, of a robot of which the links have masses."""
        if not any(b.mass > 0 for b in self.bodies):
            return []
        return [k for k, b in enumerate(self.bodies) if not b.slides]

    def change(self, terms: Sequence[Term], joint: int) -> Change:
        """The change of a joint by body terms; ``bias`` is their torque without the part of the
        joint's own inertia.
        """
        n = self.motion.shape[2]
        inertia, torque = np.zeros(n), np.zeros(n)
        gravity = turned_gravity(self.gravity, terms) - self.gravity
        if np.any(gravity):
            torque += gravity @ self.weight(joint, terms)
        for term in terms:
            link = term.joint - 1
            if term.effect == "base_tilt" or not self.moves(joint, link):
                continue
            numbers = change_of(term, self.bodies[link])
            felt, borne = self.columns(joint, link)
            inertia += numbers @ felt
            torque += numbers @ borne
        return Change(inertia, torque - inertia * self.motion[joint, 2])


def _dot(a: Array, b: Array) -> Array:
    out: Array = np.einsum("in,in->n", a, b)
    return out


def _products(a: Array, b: Array) -> Array:
    """Coefficients of a . I b in the six numbers of a symmetric I, (6, n)."""
    return np.stack([a[i] * b[j] if i == j else a[i] * b[j] + a[j] * b[i] for i, j in _PAIRS])
