"""Foreign torques in a MuJoCo reality: the forms of formulas, and six of MuJoCo's own parts and of
two joints.
"""

from __future__ import annotations

from collections.abc import Callable
from math import sin

import numpy as np

from zendsp.proof.draft import Array, Concealed, Scale
from zendsp.proof.forms import FLUID, FORMS, PLACE, draw, foreign
from zendsp.proof.mujoco.chain import YIELDING, numbers
from zendsp.proof.mujoco.machines import Bench, Torque

Rng = np.random.Generator

# MuJoCo's own parts; the number is what the part's stiffness is scaled by until it has its size
Part = Callable[[Bench, int, Scale, Rng], Callable[[float], None]]
PARTS: dict[str, tuple[str, tuple[str, ...], Part]] = {}


def part(name: str, words: str, mechanisms: tuple[str, ...]) -> Callable[[Part], Part]:
    """Enter the function below as a part of foreign machines: what it is, and which mechanisms it
    is.
    """
    def keep(function: Part) -> Part:
        PARTS[name] = (words, mechanisms, function)
        return function

    return keep


def _site(name: str, pos: tuple[float, float, float]) -> str:
    return f'<site name="{name}" pos="{numbers(pos)}"/>'


def tip(b: Bench, k: int) -> tuple[float, float, float]:
    """The far end of a link."""
    c = b.links[k].com
    return (2 * c[0], 2 * c[1], 2 * c[2])


@part("hose", "a hose from the base over the joints", (PLACE, "inertia"))
def _hose(b: Bench, joint: int, s: Scale, rng: Rng) -> Callable[[float], None]:
    last = min(max(joint, 1), b.n - 1)
    end = tip(b, last)
    b.world.still += _site("hook", (-0.15, 0.35, 0.45))
    b.world.on_link[last] = b.world.on_link.get(last, "") + _site("end", end)
    size = s.torque / (max(s.reach, 0.1) * 0.1)

    def scaled(factor: float) -> None:
        b.world.tendons = (
            f'<spatial springlength="0 0.25" stiffness="{numbers(size * factor)}"'
            f' damping="{numbers(0.01 * size * factor)}"><site site="hook"/><site'
            ' site="end"/></spatial>'
        )

    return scaled


@part("strap", "an elastic strap between two joints", (PLACE, "inertia"))
def _strap(b: Bench, joint: int, s: Scale, rng: Rng) -> Callable[[float], None]:
    other = joint - 1 if joint > 0 else min(1, b.n - 1)
    size = s.torque / (max(s.reach, 0.1) * 0.3)

    def scaled(factor: float) -> None:
        more = f'<joint joint="j{other}" coef="-0.7"/>' if other != joint else ""
        b.world.tendons = (
            f'<fixed springlength="-0.05 0.1" stiffness="{numbers(size * factor)}">'
            f'<joint joint="j{joint}" coef="1"/>{more}</fixed>'
        )

    return scaled


@part("stop", "a soft joint stop within the travel", (PLACE,))
def _stop(b: Bench, joint: int, s: Scale, rng: Rng) -> Callable[[float], None]:
    top = float(np.quantile(s.q, 0.85))
    low = float(s.q.min()) - 3 * s.reach
    base = s.torque / inertia_felt(s) / (0.1 * s.reach * YIELDING)

    def scaled(factor: float) -> None:
        k = base * factor
        b.joints[joint].stops = (low, top)
        b.joints[joint].stop_solref = (-k, -0.3 * float(np.sqrt(k)))

    return scaled


def inertia_felt(s: Scale) -> float:
    """Inertia that a joint moves, by its RMS torque and acceleration."""
    return float(np.std(s.drive) / max(float(np.std(s.a)), 1e-9))


@part("rocking", "a base that rocks on its feet", ("transmission", "inertia"))
def _rocking(b: Bench, joint: int, s: Scale, rng: Rng) -> Callable[[float], None]:
    axis = "1 0 0" if b.n > 1 or b.kind == "linear" else "0 1 0"
    kind = "slide" if b.kind == "linear" else "hinge"

    def scaled(factor: float) -> None:
        stiffness = 6e3 / factor
        b.world.base = (
            f'<joint name="rock" type="{kind}" axis="{axis}" stiffness="{numbers(stiffness)}" '
            f'damping="{numbers(0.05 * np.sqrt(stiffness))}"/>'
        )

    return scaled


def add_form(b: Bench, name: str, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """A torque by formula."""
    drawn = draw(name, s, b.sample_time, b.seconds, size, rng)

    def law(h: float) -> Torque:
        own = drawn.fresh()
        return lambda t, q, v, u: (
            drawn.factor * own(drawn.place(q), v / drawn.frame.v, t, u / drawn.rms)
        )

    b.laws.append((joint, law))
    return foreign(joint, size, FORMS[name].words, FORMS[name].mechanisms)


def across(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """Damping that depends on the pose of another joint: no law of one joint."""
    other = joint - 1 if joint > 0 else joint + 1
    middle = b.centre[other]

    def form(t: float, q: Array, v: Array) -> Array:
        out = np.zeros_like(q)
        out[joint] = -sin(3 * (q[other] - middle) + 1) * v[joint]
        return out

    b.motion = (form, 1.6 * size * s.torque / s.v_rms)
    return foreign(
        joint, size, f"damping that follows the pose of joint {other + 1}", (FLUID, "inertia")
    )


def wrench(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """A torque of the sine of the sum of two joints."""
    other = joint - 1 if joint > 0 else joint + 1

    def form(t: float, q: Array, v: Array) -> Array:
        out = np.zeros_like(q)
        out[joint] = out[other] = -sin(4 * (q[joint] + q[other]))
        return out

    b.motion = (form, 1.4 * size * s.torque)
    return foreign(joint, size, "a sine of the sum of two joints, on both", (PLACE, "inertia"))


TOGETHER = {"across": across, "wrench": wrench}


def names(joints: int) -> list[str]:
    """Forms that a machine of so many joints can show."""
    return [*FORMS, *PARTS, *(TOGETHER if joints > 1 else ())]
