"""Torques without a law in the contract: forty-two forms of position, speed, time and the motor's
torque.

A form says which mechanisms may be named for it (with ``unknown`` as the law); naming a law is
wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, exp, pi, sin, tanh

import numpy as np

from zendsp.proof.draft import Concealed, Scale

Rng = np.random.Generator
FAINT = (0.2, 0.1, 0.05, 0.02, 0.01, 0.35, 0.5)  # sizes, as shares of the RMS torque
DRY, FLUID, PLACE, TIME = "dry_friction", "fluid_friction", "position_torque", "disturbance"
RUBS = (DRY, FLUID)  # friction that differs along the travel: by what law of speed is left open


@dataclass(frozen=True)
class Frame:
    """Where and how fast a joint moves: middle, half width, RMS and peak speed; and how long it
    does.
    """

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
        (Frame, rng) -> a maker of shapes, one for every recording: some have states.
    of_state : bool
        A function of position and speed alone.
    """

    words: str
    mechanisms: tuple[str, ...]
    make: Callable[[Frame, Rng], Callable[[], Shape]]
    of_state: bool = False


FORMS: dict[str, Form] = {}


def plain(
    name: str, words: str, mechanisms: tuple[str, ...], shape: Shape, of_state: bool = True
) -> None:
    """Enter a shape that is drawn nowhere."""
    FORMS[name] = Form(words, mechanisms, lambda f, rng: lambda: shape, of_state)


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
plain(
    "q2v",
    "viscosity that grows with the square of position",
    RUBS,
    lambda x, w, t, u: -(x**2) * w,
)
plain(
    "sinqv",
    "damping and driving by turns along the travel",
    RUBS,
    lambda x, w, t, u: -sin(5 * x) * w,
)
plain("qv", "a torque of position times speed", (*RUBS, PLACE), lambda x, w, t, u: -x * w)
plain(
    "tanhqv",
    "follows the sign of position times speed",
    (*RUBS, PLACE),
    lambda x, w, t, u: -tanh(4 * x * w),
)
plain(
    "qv2", "position times speed squared", (FLUID, PLACE, "inertia"), lambda x, w, t, u: -x * w * w
)
plain(
    "cosqabsv",
    "a cosine of position times the size of speed",
    (FLUID, PLACE),
    lambda x, w, t, u: cos(4 * x) * abs(w),
)
plain(
    "cosqv2",
    "an inertia that varies along the travel, in its Coriolis torque alone",
    (FLUID, PLACE, "inertia"),
    lambda x, w, t, u: cos(5 * x) * w * w,
)
plain(
    "expqv",
    "damping that grows steeply along the travel",
    RUBS,
    lambda x, w, t, u: -exp(2 * x) * w,
)
plain(
    "onesided",
    "damping on one half of the travel only",
    RUBS,
    lambda x, w, t, u: -w if x > 0 else 0.0,
)
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
plain(
    "sinv", "a resistance that is a sine of speed", (FLUID, DRY), lambda x, w, t, u: -sin(2.5 * w)
)
plain(
    "hump", "a hump of resistance at one speed", (FLUID, DRY),
    lambda x, w, t, u: -exp(-(((abs(w) - 1) / 0.3) ** 2)) * tanh(20 * w),
)  # fmt: skip
plain(
    "rootv",
    "a resistance of the root of speed",
    (FLUID, DRY),
    lambda x, w, t, u: -tanh(50 * w) * abs(w) ** 0.5,
)
plain("v3", "a resistance of the cube of speed", (FLUID,), lambda x, w, t, u: -(w**3))
plain(
    "evenv",
    "a push that grows with the square of speed, one way",
    (FLUID,),
    lambda x, w, t, u: w * w,
)
plain(
    "thinning",
    "shear thinning: resistance that falls with speed",
    (FLUID, DRY),
    lambda x, w, t, u: -w / (1 + w * w),
)
plain(
    "dragload",
    "damping that grows with the motor's torque",
    (DRY, FLUID),
    lambda x, w, t, u: -abs(u) * w,
    False,
)
plain(
    "loadsquared",
    "friction of the square of the motor's torque",
    (DRY,),
    lambda x, w, t, u: -u * u * tanh(20 * w),
    False,
)
plain(
    "ends",
    "friction that grows towards both ends",
    (DRY,),
    lambda x, w, t, u: -tanh(20 * w) * x * x,
)
plain(
    "latch", "drags one way, on one half of the travel", (DRY,),
    lambda x, w, t, u: -max(tanh(20 * w), 0.0) * (0.5 + 0.5 * tanh(8 * x)),
)  # fmt: skip
plain(
    "windage", "a drag that differs along the travel", (FLUID,),
    lambda x, w, t, u: -w * abs(w) * (1 + sin(4 * x)),
)  # fmt: skip
plain(
    "governor", "a brake that acts above one speed", (FLUID, DRY),
    lambda x, w, t, u: -max(w - 1, 0.0) - min(w + 1, 0.0),
)  # fmt: skip
# torque of position of another law
plain(
    "wall",
    "soft stops at both ends of the travel",
    (PLACE,),
    lambda x, w, t, u: -max(x - 0.5, 0.0) - min(x + 0.5, 0.0),
)
plain(
    "well",
    "a magnet at one place",
    (PLACE,),
    lambda x, w, t, u: -(x - 0.2) * exp(-(((x - 0.2) / 0.15) ** 2)),
)
plain("abs", "a spring that pulls one way on both sides", (PLACE,), lambda x, w, t, u: -abs(x))
plain("detents", "detents with sharp teeth", (PLACE,), lambda x, w, t, u: -tanh(4 * sin(14 * x)))
plain(
    "fade",
    "a ripple that fades along the travel",
    (PLACE,),
    lambda x, w, t, u: -sin(16 * x) * (0.5 + 0.5 * x),
)
plain(
    "chirpq",
    "a ripple that is finer at one end",
    (PLACE,),
    lambda x, w, t, u: -sin(9 * (x + 1) ** 2),
)
plain(
    "plateau",
    "a torque that changes its level half-way",
    (PLACE,),
    lambda x, w, t, u: -tanh(6 * (x + 0.1)),
)
plain(
    "twosprings",
    "a spring that engages past the middle",
    (PLACE,),
    lambda x, w, t, u: -max(x - 0.1, 0.0),
)


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


@dataclass(frozen=True)
class Drawn:
    """One form on one joint, scaled: torque on the joint = factor · shape(x, w, t, u)."""

    frame: Frame
    fresh: Callable[[], Shape]
    factor: float
    rms: float  # of the motor's torque, by which u is measured

    def place(self, q: float) -> float:
        """Position within the travel, -1 to 1; a form goes on as it ends half a width beyond."""
        return min(max((q - self.frame.middle) / self.frame.half, -1.5), 1.5)


def draw(name: str, s: Scale, sample_time: float, seconds: float, size: float, rng: Rng) -> Drawn:
    """A form scaled so that its RMS along the undisturbed motion `s` is `size` of the torque's RMS.
    """
    form = FORMS[name]
    frame = Frame(0.5 * float(s.q.max() + s.q.min()), 0.5 * s.reach, s.v_rms, s.v_peak, seconds)
    fresh = form.make(frame, rng)
    either = PLACE in form.mechanisms or TIME in form.mechanisms  # what resists must not drive
    sign = float(rng.choice([-1.0, 1.0])) if either else 1.0
    alone = Drawn(frame, fresh, 1.0, s.torque)
    shape, t = fresh(), np.arange(s.q.size) * sample_time
    values = [
        shape(alone.place(q), v / frame.v, now, u / s.torque)
        for q, v, now, u in zip(s.q, s.v, t, s.drive, strict=True)
    ]
    rms = float(np.sqrt(np.mean(np.square(values)))) + 1e-300
    return Drawn(frame, fresh, sign * size * s.torque / rms, s.torque)


def foreign(joint: int, size: float, words: str, mechanisms: tuple[str, ...]) -> Concealed:
    """The truth of a foreign torque; `joint` counts from 0."""
    return Concealed("foreign", joint + 1, {}, size, note=words, mechanisms=list(mechanisms))
