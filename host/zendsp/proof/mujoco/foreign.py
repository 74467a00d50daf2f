"""Torques without a law in the contract: thirty-nine forms, from formulas and from MuJoCo's own parts.

A form says which mechanisms may be named for it (with ``unknown`` as the law); naming a law is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, exp, pi, sin, tanh

import numpy as np

from zendsp.proof.draft import Array, Concealed, Scale
from zendsp.proof.mujoco.chain import YIELDING, numbers
from zendsp.proof.mujoco.machines import Bench, Torque

Rng = np.random.Generator
DRY, FLUID, PLACE, TIME = "dry_friction", "fluid_friction", "position_torque", "disturbance"


@dataclass(frozen=True)
class Frame:
    """Where and how fast a joint moves: middle, half width, RMS and peak speed; and how long it does."""

    middle: float
    half: float
    v: float
    v_peak: float
    seconds: float


# x: place within the travel (-1 to 1), w: speed over its RMS, t: s, u: motor torque over its RMS
Shape = Callable[[float, float, float, float], float]


@dataclass(frozen=True)
class Form:
    """One form of foreign torque.

    Attributes
    ----------
    words : str
    mechanisms : tuple of str
        What may be named for it.
    make : callable
        (Frame, rng) -> shape, fresh for every recording where it has states.
    """

    words: str
    mechanisms: tuple[str, ...]
    make: Callable[[Frame, Rng], Callable[[], Shape]]


FORMS: dict[str, Form] = {}


def plain(name: str, words: str, mechanisms: tuple[str, ...], shape: Shape) -> None:
    FORMS[name] = Form(words, mechanisms, lambda f, rng: lambda: shape)


def drawn(name: str, words: str, mechanisms: tuple[str, ...]) -> Callable[..., None]:
    """Enter the function below, which draws a shape, as a form."""

    def keep(make: Callable[[Frame, Rng], Shape]) -> None:
        def fresh(f: Frame, rng: Rng) -> Callable[[], Shape]:
            shape = make(f, rng)
            return lambda: shape

        FORMS[name] = Form(words, mechanisms, fresh)

    return keep


def states(name: str, words: str, mechanisms: tuple[str, ...]) -> Callable[..., None]:
    """The same for shapes that remember: the function below gives a maker of fresh ones."""

    def keep(make: Callable[[Frame, Rng], Callable[[], Shape]]) -> None:
        FORMS[name] = Form(words, mechanisms, make)

    return keep


# products of position and speed
plain("q2v", "viscosity that grows with the square of position", (FLUID,), lambda x, w, t, u: -(x**2) * w)
plain("sinqv", "damping and driving by turns along the travel", (FLUID,), lambda x, w, t, u: -sin(5 * x) * w)
plain("qv", "a torque of position times speed", (FLUID, PLACE), lambda x, w, t, u: -x * w)
plain("tanhqv", "follows the sign of position times speed", (DRY, PLACE), lambda x, w, t, u: -tanh(4 * x * w))
plain("qv2", "position times speed squared", (FLUID, PLACE, "inertia"), lambda x, w, t, u: -x * w * w)
plain("cosqabsv", "a cosine of position times the size of speed", (FLUID, PLACE), lambda x, w, t, u: cos(4 * x) * abs(w))
plain("expqv", "damping that grows steeply along the travel", (FLUID,), lambda x, w, t, u: -exp(2 * x) * w)
plain("onesided", "damping on one half of the travel only", (FLUID,), lambda x, w, t, u: -w if x > 0 else 0.0)
plain(
    "roughhalf", "rough on one half of the travel only", (DRY,),
    lambda x, w, t, u: -tanh(20 * w) * (0.5 + 0.5 * tanh(8 * x)),
)  # fmt: skip
# friction of another law
plain("sin3tanh", "sin(3q) tanh(qd / 0.1)", (DRY,), lambda x, w, t, u: -sin(3 * x) * tanh(10 * w))
plain(
    "patch", "one rough place in the travel", (DRY,),
    lambda x, w, t, u: -tanh(20 * w) * exp(-(((x - 0.3) / 0.15) ** 2)),
)  # fmt: skip
plain("sinv", "a resistance that is a sine of speed", (FLUID, DRY), lambda x, w, t, u: -sin(2.5 * w))
plain(
    "hump", "a hump of resistance at one speed", (FLUID, DRY),
    lambda x, w, t, u: -exp(-(((abs(w) - 1) / 0.3) ** 2)) * tanh(20 * w),
)  # fmt: skip
plain("rootv", "a resistance of the root of speed", (FLUID, DRY), lambda x, w, t, u: -tanh(50 * w) * abs(w) ** 0.5)
plain("v3", "a resistance of the cube of speed", (FLUID,), lambda x, w, t, u: -(w**3))
plain("evenv", "a push that grows with the square of speed, one way", (FLUID,), lambda x, w, t, u: w * w)
plain("thinning", "shear thinning: resistance that falls with speed", (FLUID, DRY), lambda x, w, t, u: -w / (1 + w * w))
plain("dragload", "damping that grows with the motor's torque", (DRY, FLUID), lambda x, w, t, u: -abs(u) * w)
plain("loadsquared", "friction of the square of the motor's torque", (DRY,), lambda x, w, t, u: -u * u * tanh(20 * w))
# torque of position of another law
plain("wall", "soft stops at both ends of the travel", (PLACE,), lambda x, w, t, u: -max(x - 0.5, 0.0) - min(x + 0.5, 0.0))
plain("well", "a magnet at one place", (PLACE,), lambda x, w, t, u: -(x - 0.2) * exp(-(((x - 0.2) / 0.15) ** 2)))
plain("abs", "a spring that pulls one way on both sides", (PLACE,), lambda x, w, t, u: -abs(x))
plain("detents", "detents with sharp teeth", (PLACE,), lambda x, w, t, u: -tanh(4 * sin(14 * x)))
plain("fade", "a ripple that fades along the travel", (PLACE,), lambda x, w, t, u: -sin(16 * x) * (0.5 + 0.5 * x))
plain("chirpq", "a ripple that is finer at one end", (PLACE,), lambda x, w, t, u: -sin(9 * (x + 1) ** 2))
plain("plateau", "a torque that changes its level half-way", (PLACE,), lambda x, w, t, u: -tanh(6 * (x + 0.1)))
plain("twosprings", "a spring that engages past the middle", (PLACE,), lambda x, w, t, u: -max(x - 0.1, 0.0))


# of time
@drawn("chirp", "a chirp in time", (TIME,))
def _chirp(f: Frame, rng: Rng) -> Shape:
    rise = rng.uniform(0.5, 2.0) / f.seconds
    return lambda x, w, t, u: sin(2 * pi * (0.2 + rise * t) * t)


@drawn("sinet", "a sine in time, of another machine nearby", (TIME,))
def _sine(f: Frame, rng: Rng) -> Shape:
    w0, phase = 2 * pi * rng.uniform(0.5, 6.0), rng.uniform(-pi, pi)
    return lambda x, w, t, u: sin(w0 * t + phase)


@drawn("ramp", "a torque that creeps with time", (TIME, "actuator"))
def _ramp(f: Frame, rng: Rng) -> Shape:
    return lambda x, w, t, u: 2 * t / f.seconds - 1


@drawn("modulated", "damping that comes and goes with time", (TIME, FLUID))
def _modulated(f: Frame, rng: Rng) -> Shape:
    w0 = 2 * pi * rng.uniform(0.2, 0.6)
    return lambda x, w, t, u: -sin(w0 * t) * w


@drawn("gaintime", "a motor whose gain beats with time", (TIME, "actuator"))
def _gain_time(f: Frame, rng: Rng) -> Shape:
    w0 = 2 * pi * rng.uniform(0.2, 0.6)
    return lambda x, w, t, u: sin(w0 * t) * u


@drawn("gainplace", "a motor whose gain differs along the travel", ("actuator", PLACE, DRY))
def _gain_place(f: Frame, rng: Rng) -> Shape:
    return lambda x, w, t, u: sin(5 * x) * u


# with states
@states("thermal", "friction that falls with the heat it makes", (DRY, TIME))
def _thermal(f: Frame, rng: Rng) -> Callable[[], Shape]:
    pace = 6 / f.seconds

    def fresh() -> Shape:
        heat, last = 0.0, 0.0

        def shape(x: float, w: float, t: float, u: float) -> float:
            nonlocal heat, last
            step, last = t - last, t
            level = 1 / (1 + heat)
            heat += step * pace * (level * abs(w) - 0.2 * heat)
            return -level * tanh(20 * w)

        return shape

    return fresh


@states("memory", "a torque that follows the speed of a while ago", (FLUID, "transmission"))
def _memory(f: Frame, rng: Rng) -> Callable[[], Shape]:
    tau = rng.uniform(0.15, 0.4)

    def fresh() -> Shape:
        z, last = 0.0, 0.0

        def shape(x: float, w: float, t: float, u: float) -> float:
            nonlocal z, last
            step, last = t - last, t
            z += step * (w - z) / tau
            return -z

        return shape

    return fresh


@states("sloshing", "a liquid that swings in a tank", ("transmission", "inertia"))
def _sloshing(f: Frame, rng: Rng) -> Callable[[], Shape]:
    w0 = 2 * pi * rng.uniform(0.8, 1.8)

    def fresh() -> Shape:
        z, rate, last = 0.0, 0.0, 0.0

        def shape(x: float, w: float, t: float, u: float) -> float:
            nonlocal z, rate, last
            step, last = t - last, t
            rate += step * (w0**2 * (x - z) - 0.1 * w0 * rate)
            z += step * rate
            return -(x - z)

        return shape

    return fresh


@states("sticky", "a seal that sticks after rest", (DRY,))
def _sticky(f: Frame, rng: Rng) -> Callable[[], Shape]:
    def fresh() -> Shape:
        grip, last = 1.0, 0.0

        def shape(x: float, w: float, t: float, u: float) -> float:
            nonlocal grip, last
            step, last = t - last, t
            grip += step * ((1 - grip) * 4 if abs(w) < 0.05 else -8 * grip * abs(w))
            return -grip * tanh(30 * w)

        return shape

    return fresh


# MuJoCo's own parts; the number is what the part's stiffness is scaled by until it has its size
Part = Callable[[Bench, int, Scale, Rng], Callable[[float], None]]
PARTS: dict[str, tuple[str, tuple[str, ...], Part]] = {}


def part(name: str, words: str, mechanisms: tuple[str, ...]) -> Callable[[Part], Part]:
    def keep(function: Part) -> Part:
        PARTS[name] = (words, mechanisms, function)
        return function

    return keep


def site(name: str, pos: tuple[float, float, float]) -> str:
    return f'<site name="{name}" pos="{numbers(pos)}"/>'


def tip(b: Bench, k: int) -> tuple[float, float, float]:
    """The far end of a link."""
    c = b.links[k].com
    return (2 * c[0], 2 * c[1], 2 * c[2])


@part("hose", "a hose from the base over the joints", (PLACE, "inertia"))
def _hose(b: Bench, joint: int, s: Scale, rng: Rng) -> Callable[[float], None]:
    last = min(max(joint, 1), b.n - 1)
    end = tip(b, last)
    b.world.still += site("hook", (-0.15, 0.35, 0.45))
    b.world.on_link[last] = b.world.on_link.get(last, "") + site("end", end)
    size = s.torque / (max(s.reach, 0.1) * 0.1)

    def scaled(factor: float) -> None:
        b.world.tendons = (
            f'<spatial springlength="0 0.25" stiffness="{numbers(size * factor)}" damping="{numbers(0.01 * size * factor)}">'
            '<site site="hook"/><site site="end"/></spatial>'
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
    """A torque by formula, scaled so that its RMS along the undisturbed motion is `size` of the torque's."""
    form = FORMS[name]
    middle = 0.5 * float(s.q.max() + s.q.min())
    f = Frame(middle, 0.5 * s.reach, s.v_rms, s.v_peak, b.seconds)
    fresh = form.make(f, rng)
    sign = float(rng.choice([-1.0, 1.0])) if PLACE in form.mechanisms or TIME in form.mechanisms else 1.0

    def place(q: float) -> float:
        return min(max((q - f.middle) / f.half, -1.5), 1.5)

    shape = fresh()
    t = np.arange(s.q.size) * b.sample_time
    values = [
        shape(place(q), v / f.v, now, u / s.torque)
        for q, v, now, u in zip(s.q, s.v, t, s.drive, strict=True)
    ]
    factor = sign * size * s.torque / (float(np.sqrt(np.mean(np.square(values)))) + 1e-300)

    def law(h: float) -> Torque:
        own = fresh()
        return lambda t, q, v, u: factor * own(place(q), v / f.v, t, u / s.torque)

    b.laws.append((joint, law))
    return foreign(joint, size, form.words, form.mechanisms)


def foreign(joint: int, size: float, words: str, mechanisms: tuple[str, ...]) -> Concealed:
    return Concealed("foreign", joint + 1, {}, size, note=words, mechanisms=list(mechanisms))


def across(b: Bench, joint: int, s: Scale, size: float, rng: Rng) -> Concealed:
    """Damping that depends on the pose of another joint: no law of one joint."""
    other = joint - 1 if joint > 0 else joint + 1
    middle = b.centre[other]

    def form(t: float, q: Array, v: Array) -> Array:
        out = np.zeros_like(q)
        out[joint] = -sin(3 * (q[other] - middle) + 1) * v[joint]
        return out

    b.motion = (form, 1.6 * size * s.torque / s.v_rms)
    return foreign(joint, size, f"damping that follows the pose of joint {other + 1}", (FLUID, "inertia"))


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
