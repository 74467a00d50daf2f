"""Writes what a diagnosis found back into a MuJoCo model, as far as MuJoCo can express it."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from zendsp.errors import ModelError
from zendsp.physics.effects import get_effect
from zendsp.physics.model import Model, Term
from zendsp.physics.robots.bodies import changed, numbers_of, turned_gravity
from zendsp.physics.robots.mjcf import Mjcf, actuators_of, armature_of, spec_of, turned
from zendsp.physics.robots.robot import mjcf_of, robot_path, robot_tree, stated
from zendsp.tree import Body

Array = npt.NDArray[np.float64]
Attributes = dict[str, str]

SAME = 1e-4  # of the largest: MuJoCo writes six digits


@dataclass
class Split:
    """A model divided into attributes of the XML's elements, and terms that MuJoCo cannot express.
    """

    joints: dict[str, Attributes] = field(default_factory=lambda: defaultdict(dict))
    actuators: dict[str, Attributes] = field(default_factory=lambda: defaultdict(dict))
    inertials: dict[str, Attributes] = field(default_factory=dict)
    gravity: str = ""
    kept: list[Term] = field(default_factory=list)


def inexpressible(model: Model) -> tuple[Term, ...]:
    """Terms of a ``kind = "mjcf"`` model that an MJCF cannot hold."""
    return tuple(_split(model, bodies=True).kept)


def write_mjcf(model: Model, path: Path) -> Model | None:
    """Write the model's MJCF with what its terms say, and return the model that reads it.

    Parameters
    ----------
    model : Model
        Of ``kind = "mjcf"``; its terms are all that acts beside the bodies.
    path : Path
        Of the file to write.

    Returns
    -------
    Model or None
        Points to the file; its terms are what the MJCF cannot express. None, and no file, where
        the model takes only bodies from its MJCF, or what is written is not read back the same.
    """
    if model.robot.take != "all":
        return None
    for bodies in (True, False):  # a scaled total mass, say, does not let single bodies be changed
        split = _split(model, bodies)
        path.write_text(_text(model, split), encoding="utf-8")
        back = _read_back(model, path, split)
        if back is not None:
            return back
        path.unlink()
    return None


def _read_back(model: Model, path: Path, split: Split) -> Model | None:
    """The model that reads the file beside ``split.kept``, if it says what ``model`` says."""
    read = replace(
        model, file=path.name, folder=path.parent, terms=(), actuator=replace(
            model.actuator, limit=(), delay=0.0) if not model.robot.commands else model.actuator
    )  # fmt: skip
    try:
        terms, actuator, _ = stated(read, read.robot)
        whole = replace(read, terms=(*terms, *split.kept))
        if not _same(_picture(whole), _picture(model)):
            return None
    except ModelError:
        return None
    a, own = model.actuator, read.actuator
    if not model.robot.commands:  # what the file of the user said itself, it says again
        own = replace(
            own,
            limit=() if _close(actuator.limit, a.limit) else a.limit,
            delay=0.0 if _close((actuator.delay,), (a.delay,)) else a.delay,
        )
    return replace(read, terms=tuple(split.kept), actuator=own)


def _close(x: Sequence[float], y: Sequence[float]) -> bool:
    return len(x) == len(y) and bool(np.allclose(x, y, rtol=SAME, atol=0.0))


def _picture(model: Model) -> dict[tuple[str, int], Array]:
    """The content of a model in numbers that do not depend on its notation."""
    bodies, gravity = robot_tree(model)
    out: dict[tuple[str, int], Array] = {("gravity", 0): turned_gravity(gravity, model.terms)}
    for k, b in enumerate(changed(bodies, [t for t in model.terms if _site(t) == "body"])):
        out["body", k + 1] = numbers_of(b.mass, b.com, b.inertia)
    ratios: dict[int, float] = defaultdict(float)
    for term in model.terms:
        if term.effect == "torque_gain":
            ratios[term.joint] += term.value("ratio")
        elif _site(term) != "body":
            numbers = np.array([q.value for q in term.parameters.values()])
            if term.effect == "stiffness":  # k (q - neutral): springs add up so
                slope = term.value("coefficient")
                numbers = np.array([slope, slope * term.value("neutral")])
            key = (term.effect, term.joint)
            alone = key in out and term.effect not in ADDED
            out[key] = np.append(out[key], numbers) if alone else numbers + out.get(key, 0.0)
    taken = mjcf_of(model)
    for j, joint in enumerate(taken.joints, 1):
        gears = sum(abs(float(taken.model.actuator_gear[a, 0])) for a in
                    actuators_of(taken.model, joint))  # fmt: skip
        out["gain", j] = np.array([gears * (1.0 + ratios[j])])
    return out


ADDED = ("inertia", "viscous", "coulomb", "stiffness")


def _same(x: dict[tuple[str, int], Array], y: dict[tuple[str, int], Array]) -> bool:
    return all(
        (np.shape(a := x.get(key, np.zeros(1))) == np.shape(b := y.get(key, np.zeros(1)))
        and float(np.abs(a - b).max()) <= SAME * max(float(np.abs(b).max()), 1e-6))
        or (not np.any(x.get(key, 0.0)) and not np.any(y.get(key, 0.0)))
        for key in {*x, *y}
    )


def _site(term: Term) -> str:
    return get_effect(term.effect).site


def _split(model: Model, bodies: bool) -> Split:
    out, taken = Split(), mjcf_of(model)
    of_bodies = [t for t in model.terms if _site(t) == "body"]
    if bodies:
        out.kept += _bodies(out, taken, of_bodies)
    else:
        out.kept += of_bodies
    for j in range(len(taken.joints)):
        terms = [t for t in model.at(j + 1) if t not in of_bodies]
        stay = [t for t in terms if not all(q.free for q in t.parameters.values())]
        _joint(out, taken, j, [t for t in terms if t not in stay])
        if not model.robot.commands:
            _drive(out, taken, j, [t for t in terms if t not in stay])
        done = {*_JOINT, *(() if model.robot.commands else _drivable(taken, j, terms))}
        stay += [t for t in terms if t not in stay and not (t.effect in done and _whole(t, terms))]
        out.kept += stay
    return out


def _whole(term: Term, terms: Sequence[Term]) -> bool:
    """Whether all terms of this kind together are what MuJoCo allows: not below 0."""
    if term.effect not in ADDED:
        return True
    key = next(iter(term.parameters))
    return sum(t.value(key) for t in terms if t.effect == term.effect) >= 0.0


def _sum(terms: Sequence[Term], effect: str, key: str) -> float:
    return max(0.0, sum(t.value(key) for t in terms if t.effect == effect))


_JOINT: dict[str, tuple[str, str]] = {
    "inertia": ("armature", "amount"),
    "viscous": ("damping", "coefficient"),
    "coulomb": ("frictionloss", "level"),
    "stiffness": ("stiffness", "coefficient"),
}


def _joint(out: Split, taken: Mjcf, j: int, terms: Sequence[Term]) -> None:
    """Attributes of a joint: sums, since several terms act as one."""
    m, joint = taken.model, taken.joints[j]
    values = {attribute: _sum(terms, effect, key) for effect, (attribute, key) in _JOINT.items()}
    # what the rotors of its actuators add stays with them
    values["armature"] = max(0.0, values["armature"] - armature_of(m, joint) + float(
        m.dof_armature[taken.dof(j)]))  # fmt: skip
    if values["stiffness"] > 0.0:
        moment = sum(
            t.value("coefficient") * t.value("neutral") for t in terms if t.effect == "stiffness"
        )
        values["springref"] = moment / values["stiffness"]
    out.joints[_name(m, "joint", joint)].update({k: _words(v) for k, v in values.items()})


def _drivable(taken: Mjcf, j: int, terms: Sequence[Term]) -> tuple[str, ...]:
    """Effects of a joint's terms that its actuator can express: it has one, which is no servo."""
    m, found = taken.model, actuators_of(taken.model, taken.joints[j])
    if len(found) != 1 or np.any(m.actuator_biasprm[found[0]]):
        return ()
    once = [e for e in ("lag", "torque_gain") if sum(t.effect == e for t in terms) <= 1]
    if m.actuator_armature[found[0]] or np.any(m.actuator_damping[found[0]]) or (
        m.jnt_actfrclimited[taken.joints[j]]
    ):  # the gear would change these too
        once = [e for e in once if e != "torque_gain"]
    return tuple(once)


def _drive(out: Split, taken: Mjcf, j: int, terms: Sequence[Term]) -> None:
    possible = _drivable(taken, j, terms)
    if not possible:
        return
    m, a = taken.model, actuators_of(taken.model, taken.joints[j])[0]
    to = out.actuators[_name(m, "actuator", a)]
    if "lag" in possible:
        lag = [t.value("time_constant") for t in terms if t.effect == "lag"]
        to.update({"dyntype": "filterexact", "dynprm": _words(lag)} if lag else {"dyntype": "none"})
    if "torque_gain" in possible:
        gear = np.array(m.actuator_gear[a])
        ratio = sum(t.value("ratio") for t in terms if t.effect == "torque_gain")
        to["gear"] = _words(gear * (1.0 + ratio))


def _bodies(out: Split, taken: Mjcf, terms: Sequence[Term]) -> list[Term]:
    """Write bodies and gravity; what cannot be is returned."""
    lifted = any(b.lifted for b in taken.bodies)  # compensation would take up what is added to it
    if lifted:
        return list(terms)
    if any(t.effect == "base_tilt" for t in terms):
        out.gravity = _words(turned_gravity(taken.gravity, terms))
    kept: list[Term] = []
    for k in sorted({t.joint - 1 for t in terms if t.effect != "base_tilt"}):
        here = [t for t in terms if t.joint == k + 1 and t.effect != "base_tilt"]
        body = int(taken.model.jnt_bodyid[taken.joints[k]])
        # a recording tells the inertia about one axis, which may leave a body with too little about
        # others: mass and centre are written then, and that stays
        weights = [_with(t, inertia=0.0) for t in here]
        turns = [_with(t, mass=0.0, com_x=0.0, com_y=0.0, com_z=0.0) for t in here]
        for written, rest in ((here, []), (weights, turns)):
            after = changed(taken.bodies, written)[k]
            values = _inertial(taken, body, k, taken.bodies[k], after)
            if values is not None:
                out.inertials[_name(taken.model, "body", body)] = values
                kept += rest
                break
        else:
            kept += here
    return kept


def _with(term: Term, **values: float) -> Term:
    """The term with other numbers."""
    numbers = {k: replace(q, value=values.get(k, q.value)) for k, q in term.parameters.items()}
    return replace(term, parameters=numbers)


def _inertial(taken: Mjcf, body: int, link: int, before: Body, after: Body) -> Attributes | None:
    """Mass, centre and inertia of a MuJoCo body that bears all that its link gained; None where no
    body has such numbers.
    """
    m = taken.model
    owner, turn, place = taken.frames[body]
    if owner != link:  # the body goes on by another joint
        return None
    inward = turn @ turned(m.body_iquat[body])
    com = place + turn @ m.body_ipos[body]
    own = numbers_of(
        float(m.body_mass[body]), com, inward @ np.diag(m.body_inertia[body]) @ inward.T
    )
    own = own + numbers_of(after.mass, after.com, after.inertia)
    own = own - numbers_of(before.mass, before.com, before.inertia)
    mass = float(own[0])
    if mass <= 0.0:
        return None
    com = own[1:4] / mass
    xx, yy, zz, xy, xz, yz = own[4:]
    whole = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    centred = whole - mass * (float(com @ com) * np.eye(3) - np.outer(com, com))
    inertia = turn.T @ centred @ turn
    a, b, c = np.sort(np.linalg.eigvalsh(inertia))
    if a <= 0.0 or a + b < c:
        return None
    at = turn.T @ (com - place)
    six = [inertia[i] for i in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return {"pos": _words(at), "mass": _words(mass), "fullinertia": _words(six)}


def _words(values: npt.ArrayLike) -> str:
    """Numbers as the XML has them, so that reading gives the same."""
    return " ".join(repr(float(v)) for v in np.atleast_1d(np.asarray(values, dtype=np.float64)))


def _name(m: Any, what: str, index: int) -> str:
    """The part's name in the file that is written: parts without one get one."""
    return getattr(m, what)(index).name or f"{what} {index}"


def _text(model: Model, split: Split) -> str:
    """The MJCF in one file: includes resolved, assets by absolute paths."""
    source = robot_path(model)
    spec = spec_of(source)
    folder = Path(source).resolve().parent
    for key in ("meshdir", "texturedir"):
        setattr(spec, key, str((folder / getattr(spec, key)).resolve()))
    spec.compile()
    for what, parts in (("body", spec.bodies), ("joint", spec.joints),
                        ("actuator", spec.actuators)):  # fmt: skip
        for part in parts:
            part.name = part.name or f"{what} {part.id}"
    root = ElementTree.fromstring(spec.to_xml())
    by_name = _finder(root)
    for name, attributes in split.joints.items():
        by_name("worldbody", name, ("joint",)).attrib.update(attributes)
    for name, attributes in split.actuators.items():
        by_name("actuator", name, ()).attrib.update(attributes)
    for name, attributes in split.inertials.items():
        body = by_name("worldbody", name, ("body",))
        for old in body.findall("inertial"):
            body.remove(old)
        body.insert(0, ElementTree.Element("inertial", attributes))
    if split.gravity:
        option = root.find("option")
        option = ElementTree.SubElement(root, "option") if option is None else option
        option.set("gravity", split.gravity)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode") + "\n"


def _finder(root: ElementTree.Element) -> Callable[[str, str, Sequence[str]], ElementTree.Element]:
    def find(section: str, name: str, tags: Sequence[str]) -> ElementTree.Element:
        for part in root.findall(section):
            for element in part.iter():
                if element.get("name") == name and (not tags or element.tag in tags):
                    return element
        raise ModelError(f"{section} {name!r} is not in what MuJoCo writes")

    return find
