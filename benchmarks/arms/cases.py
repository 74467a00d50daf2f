"""What is concealed from the given models: 26 arms, each with its truth."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from arms.arm import Arm, about, another, make_arm
from arms.reality import Added, Laboratory, Spring, Stribeck, Wave, bodies, record
from arms.written import write_forms

Array = npt.NDArray[np.float64]
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
        ``effect@joint``; ``foreign`` where no effect of the library acts.
    without : dict
        Friction that is not given, by joint (from 0).
    added : callable
        What the arm has beside what is given: a function of the true arm.
    inside : str
        Where its FMU has dry friction.
    """

    joints: int
    truth: tuple[str, ...] = ()
    without: Without | None = None
    added: Callable[[Arm], Added] = lambda arm: Added()
    inside: str = "none"


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


def _payload(kg: float, where: tuple[float, float, float]) -> Callable[[Arm], Added]:
    return lambda arm: Added(payload=(kg, where))


def _wave(joint: int, order: float, amplitude: float) -> Callable[[Arm], Added]:
    return lambda arm: Added(wave=Wave(joint, order, amplitude, 0.8))


def _offset(joint: int) -> Callable[[Arm], Added]:
    return lambda arm: Added(offset=0.4 * arm.coulomb * (np.arange(arm.n) == joint))


def _gain(joint: int, ratio: float) -> Callable[[Arm], Added]:
    return lambda arm: Added(gain=1.0 + ratio * (np.arange(arm.n) == joint))


def _all(effect: str, joints: int) -> tuple[tuple[str, ...], Without]:
    every = tuple(range(joints))
    return tuple(f"{effect}@{j + 1}" for j in every), {effect: every}


CASES: dict[str, Case] = {
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


def make(name: str, folder: Path, seed: int = 0) -> str:
    """Write a case, and give a line on how well it was controlled. ``seed``: of arms of other
    proportions that move otherwise, with more or less of what is concealed.
    """
    case, lab, size = CASES[name], LABORATORIES[CASES[name].joints], 1.0
    rng = np.random.default_rng([*name.encode(), *([seed] if seed else [])])
    true = make_arm(case.joints, rng)
    if seed:
        true, (size, speed) = another(true, rng), rng.uniform((0.6, 0.7), (1.6, 1.3))
        lab = replace(lab, fastest=speed * lab.fastest)
    lacks = case.without or {}
    known = {
        key: about(getattr(true, key), rng)
        * [j not in lacks.get(key, ()) for j in range(case.joints)]
        for key in ("rotor", "viscous", "coulomb")
    }
    given = replace(true, **known)
    folder.mkdir(parents=True, exist_ok=True)
    write_forms(folder, given, case.inside, lab.sample_time, lab.count)
    off = []
    for which in ("fit", "heldout"):
        runs = record(true, given, case.added(true).times(size), lab, int(rng.integers(2**31)))
        np.savez(folder / f"{which}.npz", **runs)
        off.append(np.sqrt(np.mean((runs["q"] - runs["r"]) ** 2, axis=0)))
    (folder / "truth.json").write_text(json.dumps(list(case.truth)))
    assert bodies(true).nq == case.joints
    return f"{name}: off its reference by {np.round(1e3 * np.mean(off, axis=0), 1)} mrad"
