"""Reads a MuJoCo model as MuJoCo compiles it: the tree of its links, and what its joints state.

Includes, defaults and meshes are MuJoCo's to resolve. The tree is taken over only where its torques
agree with MuJoCo's own, at random states.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError
from zendsp.extras import need
from zendsp.physics.model import Quantity, Term
from zendsp.tree import Body, axis_turn, inverse_dynamics, joined
from zendsp_isr.parts import with_remedy

log = logging.getLogger(__name__)
Array = npt.NDArray[np.float64]

STATES = 8  # random states at which the tree is held against MuJoCo
AGREES = 1e-6  # of the largest torque among them: rounding is 1e-12, a missing force is far more
REACH = (1.2, 0.3)  # rad and m, how far from the reference position these states are


@dataclass(frozen=True)
class Mjcf:
    """A compiled model, restricted to the joints that a recording has.

    Attributes
    ----------
    model : mujoco.MjModel
    joints : tuple of int
        Their ids in the compiled model, in its order.
    bodies : tuple of Body
        The link that each joint moves; bodies on no joint of their own are part of it.
    frames : dict of int to (int, ndarray, ndarray)
        Of each MuJoCo body that moves: its link, and rotation and place of its frame in the link's.
    gravity : ndarray, shape (3,)
        m/s².
    """

    model: Any
    joints: tuple[int, ...]
    bodies: tuple[Body, ...]
    frames: dict[int, tuple[int, Array, Array]]
    gravity: Array

    @property
    def kinds(self) -> tuple[str, ...]:
        """``"rotary"`` or ``"linear"``, of each joint."""
        return tuple("linear" if b.slides else "rotary" for b in self.bodies)

    def dof(self, joint: int) -> int:
        """Row of a joint (from 0) in MuJoCo's vectors of speeds and torques."""
        return int(self.model.jnt_dofadr[self.joints[joint]])


def library() -> Any:
    """The package ``mujoco``; a refusal with its pip line where it is missing."""
    mj = need("mujoco", "mujoco", 'a model of kind = "mjcf"', ModelError)
    if mj.get_mju_user_warning() is None:  # its own leaves MUJOCO_LOG.TXT in the user's folder
        mj.set_mju_user_warning(log.warning)
    return mj


def read_mjcf(path: str, joints: Sequence[str] = ()) -> Mjcf:
    """Compile a MuJoCo model and take over its tree.

    Parameters
    ----------
    path : str
        Of the XML.
    joints : sequence of str
        The joints that the recording has; all others are held at their reference position. Empty:
        every joint, each of which needs an actuator of its own (or no joint has one).

    Raises
    ------
    ModelError
        A file that MuJoCo does not compile, or parts that a tree of hinges and slides does not
        have.
    """
    return _read(path, tuple(joints), Path(path).stat().st_mtime_ns if Path(path).exists() else 0)


@lru_cache(maxsize=8)
def _read(path: str, joints: tuple[str, ...], _changed: int) -> Mjcf:
    model = compiled(path)
    chosen = _chosen(model, path, joints)
    bodies, frames = _tree(model, chosen)
    taken = Mjcf(model, chosen, bodies, frames, np.array(model.opt.gravity))
    _refuse_loops(taken, path)
    _compare(taken, path)
    return taken


def compiled(path: str) -> Any:
    """The model as MuJoCo compiles it."""
    mj = library()
    if not Path(path).is_file():
        raise ModelError(f"[mechanism] file: {path}: no such file")
    if Path(path).suffix.lower() == ".urdf":
        return spec_of(path).compile()
    try:
        return mj.MjModel.from_xml_path(path)
    except (ValueError, RuntimeError, OSError) as error:
        said = with_remedy(_said(error), path)
        raise ModelError(f"{path}: MuJoCo does not compile it: {said}") from error


def spec_of(path: str) -> Any:
    """The model as it can be changed. A URDF loses its shapes where it does not compile with them,
    as where their files are missing, which it often names by packages: it states the inertias of
    its links.
    """
    mj, kind = library(), Path(path).suffix.lower()
    if kind == ".urdf":
        return _urdf(path)
    # MuJoCo takes a file for XML by its name only, and a model.mjcf of ours includes no other
    spec = (
        mj.MjSpec.from_file(path)
        if kind == ".xml"
        else mj.MjSpec.from_string(Path(path).read_text())
    )
    spec.compile()
    return spec


def _urdf(path: str) -> Any:
    """A URDF as its target simulates it (machines/mujoco/mujoco_read.h)."""
    said = []
    for shapes in (True, False):
        try:
            spec = library().MjSpec.from_file(path)
            for shape in () if shapes else [*spec.geoms, *spec.meshes]:
                spec.delete(shape)
            for body in spec.bodies:
                if _stands(body):  # its inertia plays no part: many a base_link has an impossible
                    body.explicitinertial = False
                    body.fullinertia[0] = np.nan
            spec.compile()
        except (ValueError, RuntimeError, OSError) as error:
            said.append(_said(error))
        else:
            return spec
    more = f" (and its shapes are not used: {said[0]})" if said[0] != said[1] else ""
    raise ModelError(f"{path}: MuJoCo does not compile it: {with_remedy(said[1] + more, path)}")


def _stands(body: Any) -> bool:
    """Whether no joint moves a body of a spec."""
    while body is not None and body.name != "world":
        if body.joints:
            return False
        body = body.parent
    return True


def _said(error: Exception) -> str:
    """MuJoCo's sentence on one line, without what is of no use to who has the file only."""
    return " ".join(str(error).partition("The static bodies of the spec")[0].split())


def name_of(model: Any, what: str, index: int) -> str:
    """How a sentence calls a part: its name, or its number where it has none."""
    name = getattr(model, what)(index).name
    return f"{what} {name!r}" if name else f"{what} number {index}"


def place_of(model: Any, joint: int) -> str:
    """A joint with the body that it moves, for a sentence."""
    body = name_of(model, "body", int(model.jnt_bodyid[joint]))
    return f"{name_of(model, 'joint', joint)} of {body}"


def actuators_of(model: Any, joint: int) -> list[int]:
    """Actuators that drive a joint directly."""
    trn = library().mjtTrn
    direct = (int(trn.mjTRN_JOINT), int(trn.mjTRN_JOINTINPARENT))
    return [
        a for a in range(model.nu)
        if int(model.actuator_trntype[a]) in direct and int(model.actuator_trnid[a, 0]) == joint
    ]  # fmt: skip


def _chosen(model: Any, path: str, names: tuple[str, ...]) -> tuple[int, ...]:
    mj = library()
    single = (int(mj.mjtJoint.mjJNT_HINGE), int(mj.mjtJoint.mjJNT_SLIDE))
    have = [model.joint(k).name for k in range(model.njnt)]
    hint = "name the joints that the recording has, [mechanism] joints = [\"…\"], the others are" \
        " held at their reference position"
    for name in names:
        if name not in have:
            raise ModelError(
                f"{path}: [mechanism] joints: there is no joint {name!r}; it has"
                f" {', '.join(n for n in have if n) or 'none with a name'}"
            )
    chosen = tuple(k for k in range(model.njnt) if have[k] in names) if names else tuple(
        range(model.njnt)
    )
    if names and [have[k] for k in chosen] != list(names):
        raise ModelError(
            f"{path}: [mechanism] joints = {list(names)}: expected each once, in the order of the"
            f" file: {[have[k] for k in chosen]}"
        )
    if not chosen:
        raise ModelError(f"{path}: has no joint that moves")
    if not (np.isfinite(model.body_mass).all() and np.isfinite(model.body_inertia).all()):
        raise ModelError(f"{path}: a mass or an inertia is no finite number")
    for k in chosen:
        if int(model.jnt_type[k]) not in single:
            kind = "ball" if int(model.jnt_type[k]) == int(mj.mjtJoint.mjJNT_BALL) else "free"
            raise ModelError(
                f"{path}: {place_of(model, k)} is a {kind} joint: only hinges and slides can be"
                f" taken over; {hint}"
            )
        if not names and model.nu and not actuators_of(model, k):
            raise ModelError(f"{path}: {place_of(model, k)} has no actuator of its own: {hint}")
    return chosen


def turned(quaternion: Array) -> Array:
    """The rotation matrix of a quaternion, (3, 3)."""
    out = np.empty(9)
    library().mju_quat2Mat(out, np.asarray(quaternion, dtype=np.float64))
    return out.reshape(3, 3)


def _tree(
    m: Any, chosen: tuple[int, ...]
) -> tuple[tuple[Body, ...], dict[int, tuple[int, Array, Array]]]:
    """Links of the chosen joints. A link's frame is its body's, moved to the anchor of the joint.
    """
    links: list[Body] = []
    # of each body: its link (-1: stands), rotation and place of its frame in the link's
    at: dict[int, tuple[int, Array, Array]] = {0: (-1, np.eye(3), np.zeros(3))}
    slide = int(library().mjtJoint.mjJNT_SLIDE)
    for b in range(1, m.nbody):
        link, turn, place = at[int(m.body_parentid[b])]
        place = place + turn @ m.body_pos[b]
        turn = turn @ turned(m.body_quat[b])
        for k in range(int(m.body_jntadr[b]), int(m.body_jntadr[b]) + int(m.body_jntnum[b])):
            if k not in chosen:  # held at its reference position
                continue
            axis, anchor = np.array(m.jnt_axis[k]), np.array(m.jnt_pos[k])
            start = float(m.qpos0[m.jnt_qposadr[k]])
            slides = int(m.jnt_type[k]) == slide
            place = place + turn @ anchor - (start * (turn @ axis) if slides else 0.0)
            if not slides:
                turn = axis_turn(axis, np.array([-start]), turn)[..., 0]
            name = m.body(b).name or f"body {b}"
            links.append(
                Body(link, slides, axis, turn, place, 0.0, np.zeros(3), np.zeros((3, 3)), name)
            )
            link, turn, place = len(links) - 1, np.eye(3), -anchor
        at[b] = (link, turn, place)
        if link >= 0:
            own = turn @ turned(m.body_iquat[b])
            com = place + turn @ m.body_ipos[b]
            mass, lifted = float(m.body_mass[b]), float(m.body_gravcomp[b])
            link_body = links[link]
            links[link] = replace(
                joined(link_body, mass, com, own @ np.diag(m.body_inertia[b]) @ own.T),
                lifted=(*link_body.lifted, (lifted * mass, com)) if lifted and mass else
                link_body.lifted,
            )
    return tuple(links), {b: x for b, x in at.items() if x[0] >= 0}


def _refuse_loops(taken: Mjcf, path: str) -> None:
    """Refuse parts that connect links other than by joints."""
    mj, m = library(), taken.model

    def link(body: int) -> int:
        return taken.frames[body][0] if body in taken.frames else -1

    for e in np.flatnonzero(np.asarray(m.eq_active0)):
        kind, what = int(m.eq_type[e]), name_of(m, "equality", int(e))
        ends = [int(m.eq_obj1id[e]), int(m.eq_obj2id[e])]
        if kind == int(mj.mjtEq.mjEQ_JOINT):
            tied = [k for k in ends if k in taken.joints]
            where = place_of(m, tied[0]) if tied else ""
        elif kind in (int(mj.mjtEq.mjEQ_CONNECT), int(mj.mjtEq.mjEQ_WELD)):
            if int(m.eq_objtype[e]) == int(mj.mjtObj.mjOBJ_SITE):
                ends = [int(m.site_bodyid[s]) for s in ends]
            where = name_of(m, "body", ends[0]) if link(ends[0]) != link(ends[1]) else ""
        else:  # of tendons: see there
            continue
        if where:
            raise ModelError(
                f"{path}: {what} closes a loop at {where}: only trees of hinges and slides can be"
                " taken over; [mechanism] joints = [\"…\"] leaves the joints of a loop out"
            )
    for t in range(m.ntendon):
        first = int(m.tendon_adr[t])
        wraps = range(first, first + int(m.tendon_num[t]))
        if int(m.wrap_type[first]) == int(mj.mjtWrap.mjWRAP_JOINT):
            tied = [k for k in (int(m.wrap_objid[w]) for w in wraps) if k in taken.joints]
            where = place_of(m, tied[0]) if tied else ""
        else:
            site = int(mj.mjtWrap.mjWRAP_SITE)
            on = [int(m.site_bodyid[m.wrap_objid[w]]) for w in wraps if int(m.wrap_type[w]) == site]
            moving = [b for b in on if len({link(x) for x in on}) > 1 and link(b) >= 0]
            where = name_of(m, "body", moving[0]) if moving else ""
        if where and _pulls(m, t):
            raise ModelError(
                f"{path}: {name_of(m, 'tendon', t)} pulls at {where}: tendons with a force of their"
                " own cannot be taken over; name a copy of the file without it as [mechanism] file,"
                " and a diagnosis finds what it does"
            )


def _pulls(m: Any, tendon: int) -> bool:
    """Whether a tendon bears a force: spring, damper, friction, limit, equality or actuator."""
    mj = library()
    own = any(
        np.any(getattr(m, key)[tendon])
        for key in ("tendon_stiffness", "tendon_damping", "tendon_frictionloss", "tendon_armature",
                    "tendon_limited")
    )  # fmt: skip
    driven = any(
        int(m.actuator_trntype[a]) == int(mj.mjtTrn.mjTRN_TENDON)
        and int(m.actuator_trnid[a, 0]) == tendon
        for a in range(m.nu)
    )
    tied = any(
        int(m.eq_type[e]) == int(mj.mjtEq.mjEQ_TENDON)
        and tendon in (int(m.eq_obj1id[e]), int(m.eq_obj2id[e]))
        for e in np.flatnonzero(np.asarray(m.eq_active0))
    )
    return own or driven or tied


def stated_terms(taken: Mjcf) -> list[Term]:
    """The effects that the joints state: armature, damping, frictionloss, stiffness."""
    m, out = taken.model, []
    for j, k in enumerate(taken.joints):
        d = taken.dof(j)
        rows = (
            ("inertia", {"amount": armature_of(m, k)}),
            ("viscous", {"coefficient": float(m.dof_damping[d])}),
            ("coulomb", {"level": float(m.dof_frictionloss[d])}),
            (
                "stiffness",
                {
                    "coefficient": float(m.jnt_stiffness[k]),
                    "neutral": float(m.qpos_spring[m.jnt_qposadr[k]]),
                },
            ),
        )
        for effect, values in rows:
            if next(iter(values.values())) != 0.0:
                out.append(Term(effect, j + 1, {n: Quantity(v) for n, v in values.items()}))
    return out


def armature_of(m: Any, joint: int) -> float:
    """Rotor inertia of a joint, with what its actuators carry behind their gear."""
    rotors = (
        float(m.actuator_armature[a]) * float(m.actuator_gear[a, 0]) ** 2
        for a in actuators_of(m, joint)
    )
    return float(m.dof_armature[m.jnt_dofadr[joint]]) + sum(rotors)


def _compare(taken: Mjcf, path: str) -> None:
    """Refuse a model whose torques are not those of its tree and of what its joints state."""
    mj, m = library(), taken.model
    flags = int(m.opt.disableflags)
    off = mj.mjtDisableBit
    m.opt.disableflags = flags | int(off.mjDSBL_CONSTRAINT) | int(off.mjDSBL_ACTUATION)
    data, n = mj.MjData(m), len(taken.joints)
    rng = np.random.default_rng(1)
    dofs = [taken.dof(j) for j in range(n)]
    at = [int(m.jnt_qposadr[k]) for k in taken.joints]
    reach = np.array([REACH[b.slides] for b in taken.bodies])
    q = np.array(m.qpos0)[at] + reach * rng.uniform(-1.0, 1.0, (STATES, n))
    qd, qdd = 2.0 * rng.uniform(-1.0, 1.0, (2, STATES, n))
    theirs = np.empty((STATES, n))
    for row in range(STATES):
        data.qpos[:] = m.qpos0
        data.qvel[:], data.qacc[:] = 0.0, 0.0
        data.qpos[at], data.qvel[dofs], data.qacc[dofs] = q[row], qd[row], qdd[row]
        mj.mj_inverse(m, data)
        theirs[row] = data.qfrc_inverse[dofs]
    m.opt.disableflags = flags
    ours = inverse_dynamics(taken.bodies, taken.gravity, q, qd, qdd)
    laws = {
        "inertia": lambda t, j: t.value("amount") * qdd[:, j],
        "viscous": lambda t, j: t.value("coefficient") * qd[:, j],
        "stiffness": lambda t, j: t.value("coefficient") * (q[:, j] - t.value("neutral")),
    }
    for term in stated_terms(taken):
        if term.effect in laws:  # dry friction is a constraint of MuJoCo's, and off here
            ours[:, term.joint - 1] += laws[term.effect](term, term.joint - 1)
    off_by = np.abs(ours - theirs).max(axis=0)
    limit = AGREES * max(float(np.abs(theirs).max()), 1e-9)
    worst = int(np.argmax(off_by))
    if off_by[worst] > limit:
        raise ModelError(
            f"{path}: {place_of(m, taken.joints[worst])}: MuJoCo's torque is"
            f" {off_by[worst]:.3g} {'N' if taken.bodies[worst].slides else 'N m'} away from that of"
            " rigid links with armature, damping and stiffness; a force of the model cannot be"
            " taken over (fluid, a polynomial spring, a plugin): remove it, or state it as an"
            " [[effect]]"
        )
