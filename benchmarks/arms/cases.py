"""What is concealed from the given models, each arm with its truth, in two groups."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from arms.arm import Arm, about, another, make_arm
from arms.reality import Added, Laboratory, Payload, Rough, Spring, Stribeck, Wave, bodies, record
from arms.written import write_forms

Array = npt.NDArray[np.float64]
COM = ("com_x", "com_y", "com_z")
Without = Mapping[str, tuple[int, ...]]  # friction that is not given, by joint from 0

LABORATORIES = {
    2: Laboratory(0.002, 15.0, 2 * np.pi / 2**14),
    3: Laboratory(0.002, 12.0, 2 * np.pi / 2**16),
    6: Laboratory(0.004, 16.0, 2 * np.pi / 2**17, fastest=0.8),
    7: Laboratory(0.004, 14.0, 2 * np.pi / 2**17, fastest=0.9),
}


@dataclass(frozen=True)
class Case:
    """One arm.

    Attributes
    ----------
    truth : tuple of str
        ``effect@joint``, or several in ``|`` that are one thing; ``foreign`` where no effect of the
        library acts.
    without : dict
        Friction that is not given, by joint (from 0).
    added : callable
        What the arm has beside what is given: a function of the true arm.
    inside : str
        Where its FMU has dry friction.
    wrong : callable
        The arm as its file has it: a function of the true arm and of what is drawn.
    stated : str
        A further ``[[effect]]`` of the model file.
    rough : bool
        Whether friction is no straight line, and its file has the line through it.
    """

    joints: int
    truth: tuple[str, ...] = ()
    without: Without | None = None
    added: Callable[[Arm], Added] = lambda arm: Added()
    inside: str = "none"
    wrong: Callable[[Arm, np.random.Generator], Arm] = lambda arm, rng: arm
    stated: str = ""
    rough: bool = False


def _spring(joint: int, hz: float, gap: float = 0.0) -> Callable[[Arm], Added]:
    """A spring by which a motor rings at some Hz against a held link."""

    def added(arm: Arm) -> Added:
        stiffness = arm.rotor[joint] * (2 * np.pi * hz) ** 2
        return Added(spring=Spring(joint, stiffness, stiffness * 5e-4, gap))

    return added


def _stribeck(joint: int) -> Callable[[Arm], Added]:
    return lambda arm: Added(stribeck=Stribeck(joint, 0.8 * arm.coulomb[joint], 0.08))


def _hose(first: int, slack: float) -> Callable[[Arm], Added]:
    """A hose along two joints: it pulls both where they bend beyond its slack (rad)."""

    def torque(level: float, t: float, q: Array, qd: Array) -> Array:
        out = np.zeros(len(q))
        bend = q[first] + 0.7 * q[first + 1]
        pull = level * max(0.0, abs(bend) - slack) * np.sign(bend)
        out[first], out[first + 1] = -pull, -0.7 * pull
        return out

    return lambda arm: Added(torque=partial(torque, 3.0 * float(arm.coulomb[first + 1])))


def _push(joint: int) -> Callable[[Arm], Added]:
    """A hand that pushes for half a second, five times in a recording."""

    def torque(level: float, t: float, q: Array, qd: Array) -> Array:
        out = np.zeros(len(q))
        at = (t % 3.1) - 2.2
        if 0.0 < at < 0.5:
            out[joint] = level * np.sin(2 * np.pi * at)
        return out

    return lambda arm: Added(torque=partial(torque, 2.0 * float(arm.coulomb[joint])))


def _swirl(joint: int) -> Callable[[Arm], Added]:
    """A torque of time alone, never at rest: three tones that no law has."""

    def torque(level: float, t: float, q: Array, qd: Array) -> Array:
        out = np.zeros(len(q))
        out[joint] = level * (np.sin(9.1 * t) + np.sin(5.3 * t + 2 * np.sin(1.7 * t)))
        return out

    return lambda arm: Added(torque=partial(torque, 0.5 * float(arm.coulomb[joint])))


def _payload(
    kg: float, where: tuple[float, float, float], link: int = -1, radius: float = 0.05
) -> Callable[[Arm], Added]:
    return lambda arm: Added(payload=Payload(kg, where, link, radius))


def _tilt(about_x: float, about_y: float) -> Callable[[Arm], Added]:
    return lambda arm: Added(tilt=(about_x, about_y))


def _torsion(joint: int, stiffness: float) -> Callable[[Arm], Added]:
    """A balancer by a torsion spring: N m/rad, about the joint's zero."""

    def torque(t: float, q: Array, qd: Array) -> Array:
        return -stiffness * q * (np.arange(len(q)) == joint)

    return lambda arm: Added(torque=torque)


def _gas_spring(joint: int) -> Callable[[Arm], Added]:
    """A balancer by a spring from a point 0.25 m above the joint to one of the link, 0.1 m from it:
    300 N, and 2 N more a mm.
    """

    def torque(t: float, q: Array, qd: Array) -> Array:
        length = np.sqrt(0.0725 - 0.05 * np.cos(q[joint]))
        lever = 0.025 * np.sin(q[joint]) / length
        return -(300.0 + 2000.0 * (length - 0.15)) * lever * (np.arange(len(q)) == joint)

    return lambda arm: Added(torque=torque)


def _mass(link: int) -> Callable[[Arm, np.random.Generator], Arm]:
    """A link that is 10 % lighter or heavier in the file, as by another density."""

    def wrong(arm: Arm, rng: np.random.Generator) -> Arm:
        by = np.where(np.arange(arm.n) == link, rng.choice((0.9, 1.1)), 1.0)
        return replace(arm, mass=by * arm.mass, inertia=by[:, None] * arm.inertia)

    return wrong


def _centre(link: int) -> Callable[[Arm, np.random.Generator], Arm]:
    """A link whose centre of mass is 30 mm off in the file, across its joint's axis."""

    def wrong(arm: Arm, rng: np.random.Generator) -> Arm:
        way = rng.standard_normal(3) * (1.0 - arm.axis[link])
        com = arm.com.copy()
        com[link] += 0.03 * way / np.linalg.norm(way)
        return replace(arm, com=com)

    return wrong


def _rotor(joint: int, given: float) -> Callable[[Arm, np.random.Generator], Arm]:
    """A rotor of which the file has a part."""
    return lambda arm, rng: replace(
        arm, rotor=arm.rotor * np.where(np.arange(arm.n) == joint, given, 1.0)
    )


def _wave(joint: int, order: float, amplitude: float) -> Callable[[Arm], Added]:
    return lambda arm: Added(wave=Wave(joint, order, amplitude, 0.8))


def _offset(joint: int) -> Callable[[Arm], Added]:
    return lambda arm: Added(offset=0.4 * arm.coulomb * (np.arange(arm.n) == joint))


def _gain(joint: int, ratio: float) -> Callable[[Arm], Added]:
    return lambda arm: Added(gain=1.0 + ratio * (np.arange(arm.n) == joint))


def _all(effect: str, joints: int) -> tuple[tuple[str, ...], Without]:
    every = tuple(range(joints))
    return tuple(f"{effect}@{j + 1}" for j in every), {effect: every}


FORMS_TOLD: dict[str, Case] = {
    "complete2": Case(2),
    "complete2s": Case(2, inside="sticks"),
    "complete3": Case(3, inside="smooth"),
    "complete6": Case(6, inside="sticks"),
    "complete7": Case(7),
    "coulomb2": Case(2, *_all("coulomb", 2)),
    "coulomb3": Case(3, *_all("coulomb", 3)),
    "coulomb6": Case(6, *_all("coulomb", 6)),
    "coulomb7": Case(7, *_all("coulomb", 7)),
    "viscous2": Case(2, ("viscous@1",), {"viscous": (0,)}, inside="sticks"),
    "viscous3": Case(3, ("viscous@2",), {"viscous": (1,)}),
    "stribeck2": Case(2, ("stribeck@1",), added=_stribeck(0)),
    "stribeck3": Case(3, ("stribeck@3",), added=_stribeck(2), inside="sticks"),
    "elasticity2": Case(2, ("elasticity@2",), added=_spring(1, 14.0)),
    "elasticity3": Case(3, ("elasticity@2",), added=_spring(1, 10.0)),
    "backlash2": Case(2, ("backlash@1",), added=_spring(0, 30.0, 0.006)),
    "wave2": Case(2, ("transmission_error@1",), added=_wave(0, 40.0, 4e-4)),
    "wave3": Case(3, ("transmission_error@2",), added=_wave(1, 60.0, 2e-4)),
    "offset3": Case(3, ("torque_offset@2",), added=_offset(1)),
    "gain2": Case(2, ("torque_gain@2",), added=_gain(1, -0.12), inside="sticks"),
    "hose3": Case(3, ("foreign",), added=_hose(1, 0.25)),
    "hose6": Case(6, ("foreign",), added=_hose(1, 0.2)),
    "payload2": Case(2, ("payload@2",), added=_payload(0.5, (0.0, 0.0, -0.3))),
    "payload6": Case(6, ("payload@6",), added=_payload(2.0, (0.03, 0.0, 0.08))),
    "push2": Case(2, ("disturbance@2",), added=_push(1)),
    "swirl3": Case(3, ("foreign",), added=_swirl(1)),
}


def _carries(
    joints: int, kg: float, where: tuple[float, float, float], radius: float = 0.05
) -> Case:
    """A payload at the tool, all else as it is given."""
    return Case(joints, (f"payload@{joints}",), added=_payload(kg, where, radius=radius))


def _carries_with_friction(joints: int, kg: float, where: tuple[float, float, float]) -> Case:
    """The same, and all dry friction is left out."""
    friction, without = _all("coulomb", joints)
    return Case(joints, (f"payload@{joints}", *friction), without, added=_payload(kg, where))


TWO_DEG = float(np.deg2rad(2.0))
STATED = (
    '\n[[effect]]\nkind = "stiffness"\njoint = 2\ncoefficient = { value = 15.0, free = false }\n'
)

BODIES: dict[str, Case] = {
    "payload2a": _carries(2, 0.5, (0.0, 0.0, -0.3)),
    "payload2b": _carries(2, 1.5, (0.05, 0.02, -0.25)),
    "payload2c": _carries_with_friction(2, 1.0, (0.0, 0.0, -0.28)),
    "payload3": _carries(3, 1.5, (0.04, 0.03, 0.25)),
    "payload6a": _carries(6, 0.5, (0.0, 0.0, 0.1), 0.03),
    "payload6b": _carries(6, 2.0, (0.03, -0.05, 0.08)),
    "payload6c": _carries(6, 5.0, (0.0, 0.04, 0.15), 0.08),
    "payload6d": _carries_with_friction(6, 1.5, (0.02, 0.0, 0.06)),
    "payload7a": _carries(7, 0.5, (0.0, 0.02, 0.08), 0.03),
    "payload7b": _carries(7, 2.5, (-0.04, 0.0, 0.12)),
    "payload7c": _carries(7, 5.0, (0.0, 0.0, 0.1), 0.08),
    "payload7d": _carries_with_friction(7, 1.5, (0.0, 0.03, 0.1)),
    "mass2": Case(2, ("body@2",), wrong=_mass(1)),
    "mass3": Case(3, ("body@2",), wrong=_mass(1)),
    "mass6": Case(6, ("body@2",), wrong=_mass(1)),
    "mass7": Case(7, ("body@4",), wrong=_mass(3)),
    "centre2": Case(2, ("body@2",), wrong=_centre(1)),
    "centre3": Case(3, ("body@3",), wrong=_centre(2)),
    "centre6": Case(6, ("body@3",), wrong=_centre(2)),
    "centre7": Case(7, ("body@4",), wrong=_centre(3)),
    "rotor2": Case(2, ("inertia@1",), wrong=_rotor(0, 0.5)),
    "rotor6": Case(6, ("inertia@3",), wrong=_rotor(2, 0.7)),
    "rotor7": Case(7, ("inertia@2",), wrong=_rotor(1, 0.0)),
    "balancer3": Case(3, ("stiffness@2",), added=_torsion(1, 7.0)),
    "balancer6a": Case(6, ("position_torque@2",), added=_gas_spring(1)),
    "balancer6b": Case(6, ("payload@2|body@2",), added=_payload(4.0, (0.0, 0.0, -0.2), 1)),
    "balancer6c": Case(6, ("stiffness@2",), added=_torsion(1, 40.0), stated=STATED),
    "tilt2": Case(2, ("base_tilt@1",), added=_tilt(0.0, TWO_DEG)),
    "tilt3": Case(3, ("base_tilt@1",), added=_tilt(TWO_DEG, 0.0)),
    "tilt6": Case(6, ("base_tilt@1",), added=_tilt(-0.6 * TWO_DEG, 0.8 * TWO_DEG)),
    "tilt7": Case(7, ("base_tilt@1",), added=_tilt(0.0, -TWO_DEG)),
}


def _rough(case: Case) -> Case:
    """The same with real friction: what is left out of it may have any law."""
    return replace(case, rough=True, truth=tuple(x.replace("coulomb", DRY) for x in case.truth))


DRY, FLUID = "dry_friction", "fluid_friction"
ROUGH = {
    f"{name}r": _rough((FORMS_TOLD | BODIES)[name])
    for name in (
        "complete3", "complete6",
        "payload2a", "payload2c", "payload3", "payload6a", "payload6b", "payload6d", "payload7b",
        "mass2", "mass6", "centre3", "centre6", "rotor6", "balancer3", "balancer6a", "tilt3",
        "tilt6",
    )
}  # fmt: skip
GROUPS = {"forms": FORMS_TOLD, "bodies": BODIES, "rough": ROUGH}
CASES = FORMS_TOLD | BODIES | ROUGH


def make(name: str, folder: Path, seed: int = 0) -> str:
    """Write a case, and give a line on how well it was controlled. ``seed``: of arms of other
    proportions that move otherwise, with more or less of what is concealed.
    """
    case, size = CASES[name], 1.0
    lab = LABORATORIES[case.joints]
    rng = np.random.default_rng([*name.encode(), *([seed] if seed else [])])
    true = make_arm(case.joints, rng)
    if seed:
        true, (size, speed) = another(true, rng), rng.uniform((0.6, 0.7), (1.6, 1.3))
        lab = replace(lab, fastest=speed * lab.fastest)
    lacks = case.without or {}
    rough = Rough() if case.rough else None
    line = true if rough is None else rough.line(true)
    known = {
        key: about(getattr(line, key), rng)
        * [j not in lacks.get(key, ()) for j in range(case.joints)]
        for key in ("rotor", "viscous", "coulomb")
    }
    given = case.wrong(replace(true, **known), rng)
    added = replace(case.added(true).times(size), rough=rough)
    folder.mkdir(parents=True, exist_ok=True)
    write_forms(folder, given, case.inside, lab.sample_time, lab.count, case.stated)
    off = []
    for which in ("fit", "heldout"):
        runs = record(true, given, added, lab, int(rng.integers(2**31)))
        np.savez(folder / f"{which}.npz", **runs)
        off.append(np.sqrt(np.mean((runs["q"] - runs["r"]) ** 2, axis=0)))
    numbers = {}
    if added.payload is not None:
        numbers = dict(zip(("mass", *COM), (added.payload.kg, *added.payload.where), strict=True))
    also = (DRY, FLUID) if case.rough else ()
    truth = {"truth": case.truth, "numbers": numbers, "also": also}
    (folder / "truth.json").write_text(json.dumps(truth))
    assert bodies(true).nq == case.joints
    return f"{name}: off its reference by {np.round(1e3 * np.mean(off, axis=0), 1)} mrad"
