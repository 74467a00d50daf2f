"""Concealed effects drawn at random, of a size that matters on the machine: large enough to be
there, small enough to hide.

Sizes are relative to what the machine has: friction level, viscous coefficient, inertia, usual
speed of each joint.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from zendsp_protocol.errors import Refused, did_you_mean
from zendsp_target.concealed.sealed import Concealed, ConcealedEffect


@dataclass(frozen=True)
class Scale:
    """What is usual on one joint."""

    friction: float  # N m, Coulomb
    viscous: float  # N m s/rad
    inertia: float  # kg m^2
    speed: float  # rad/s
    gravity: float  # N m, 0 where the axis is vertical
    torque: float  # N m, what an ordinary motion asks for at its peaks


@dataclass(frozen=True)
class Usual:
    """What is usual on one machine."""

    joints: tuple[Scale, ...]
    excluded: frozenset[str] = frozenset()
    heavy: tuple[int, ...] = ()  # joints whose inertia can be felt over their friction; empty: all
    period: float = 0.001  # s: delays are whole samples
    # mass, kg, and x, y, z on the last link, m: lowest and highest of each
    payload: tuple[tuple[float, float], ...] = ()


MACHINES: dict[str, Usual] = {
    "imi_planar": Usual(
        (Scale(8.45, 5.3, 3.4, 1.5, 0.0, 28.0), Scale(2.35, 1.1, 0.15, 2.0, 0.0, 6.0)),
        payload=((1.0, 4.0), (0.2, 0.34), (-0.03, 0.03), (0.0, 0.0)),
    ),
    # one joint: nothing to couple with
    "pendulum": Usual((Scale(0.1, 0.005, 2.07e-3, 5.0, 0.167, 0.3),), frozenset({"coupling"})),
    # a saturation below the torque that holds the arm up would drop it
    "wam7": Usual(
        tuple(
            Scale(*row)
            for row in (
                (4.4, 1.1, 0.6, 0.6, 0.0, 8.0),
                (3.1, 3.2, 0.7, 0.6, 30.0, 35.0),
                (2.0, 0.8, 0.03, 0.6, 0.0, 3.0),
                (1.1, 0.5, 0.12, 0.6, 4.0, 6.0),
                (0.2, 0.9, 6e-4, 0.8, 0.0, 1.0),
                (0.46, 0.5, 6e-4, 0.8, 0.1, 1.0),
                (0.1, 0.9, 7e-5, 0.8, 0.0, 1.0),
            )
        ),
        frozenset({"saturation"}),
        heavy=(1, 2, 4),
        payload=((0.5, 3.0), (-0.04, 0.04), (-0.04, 0.04), (0.02, 0.15)),
    ),
}

Draw = Callable[[random.Random, Scale, Usual], Mapping[str, float]]


def _sign(r: random.Random) -> float:
    return r.choice((-1.0, 1.0))


def _angle(r: random.Random) -> float:
    return r.uniform(-math.pi, math.pi)


def _coulomb_asymmetry(r: random.Random, s: Scale, u: Usual) -> Mapping[str, float]:
    strong, weak = r.uniform(0.4, 0.8) * s.friction, r.uniform(0.0, 0.1) * s.friction
    return dict(zip(("level_pos", "level_neg"), r.sample((strong, weak), 2), strict=True))


def _viscous_asymmetry(r: random.Random, s: Scale, u: Usual) -> Mapping[str, float]:
    b = max(s.viscous, 0.3 * s.friction / s.speed)
    return dict(
        zip(
            ("coefficient_pos", "coefficient_neg"),
            r.sample((r.uniform(0.8, 1.5) * b, 0.1 * b), 2),
            strict=True,
        )
    )


def _elasticity(r: random.Random, s: Scale, u: Usual) -> Mapping[str, float]:
    load, frequency = r.uniform(0.45, 0.65) * s.inertia, r.uniform(5.0, 12.0)
    k = load * (2 * math.pi * frequency) ** 2
    return {"stiffness": k, "damping": 0.04 * math.sqrt(k * load), "load_inertia": load}


def _backlash(r: random.Random, s: Scale, u: Usual) -> Mapping[str, float]:
    load = r.uniform(0.45, 0.65) * s.inertia
    return {
        "gap": r.uniform(0.015, 0.05),
        "stiffness": load * (2 * math.pi * r.uniform(15.0, 30.0)) ** 2,
        "load_inertia": load,
    }


def _hysteresis(r: random.Random, s: Scale, u: Usual) -> Mapping[str, float]:
    force = r.uniform(0.5, 1.2) * s.friction
    return {"force": force, "stiffness": force / r.uniform(0.05, 0.2), "exponent": 1.0}


def _coupling(r: random.Random, s: Scale, u: Usual) -> Mapping[str, float]:
    """Parameters of a coupling; `draw_effect`, which knows the joint, fills in ``from_joint``."""
    # by acceleration, at one joint alone, no bodies do: a planar arm has another p2 for each joint
    law = r.randrange(4) or 3
    size = (0.3 * s.inertia, s.friction / s.speed**2, s.friction / s.speed, s.friction)[law]
    return {"from_joint": 0.0, "law": float(law), "coefficient": r.uniform(0.4, 0.9) * size}


def _gravity(r: random.Random, s: Scale, u: Usual) -> Mapping[str, float]:
    # a tilted base or an unbalance; on a pendulum an angle, since sin q alone is its own gravity
    return {
        "torque": r.uniform(0.3, 0.8) * (s.gravity or s.friction),
        "angle": _sign(r) * r.uniform(0.5, 1.5),
    }


DRAWS: dict[str, Draw] = {
    "viscous": lambda r, s, u: {
        "coefficient": r.uniform(0.8, 1.6) * max(s.viscous, 0.3 * s.friction / s.speed)
    },
    "viscous_asymmetry": _viscous_asymmetry,
    "coulomb": lambda r, s, u: {"level": r.uniform(0.4, 1.0) * s.friction},
    "coulomb_asymmetry": _coulomb_asymmetry,
    "stribeck": lambda r, s, u: {
        "breakaway": r.uniform(1.6, 2.4) * s.friction,
        "velocity": r.uniform(0.03, 0.12) * s.speed,
    },
    "presliding": lambda r, s, u: {"stiffness": s.friction / r.uniform(0.015, 0.04)},
    "quadratic_drag": lambda r, s, u: {
        "coefficient": r.uniform(0.6, 1.2) * s.friction / s.speed**2
    },
    "load_friction": lambda r, s, u: {"coefficient": r.uniform(0.15, 0.4)},
    "position_friction": lambda r, s, u: {
        "amplitude": r.uniform(0.4, 0.8) * s.friction,
        "period": r.uniform(0.3, 1.2),
        "phase": _angle(r),
    },
    "friction_drift": lambda r, s, u: {
        "ratio": r.uniform(0.5, 1.0),
        "time_constant": r.uniform(2.0, 6.0),
    },
    "gravity": _gravity,
    "stiffness": lambda r, s, u: {
        "coefficient": r.uniform(0.6, 1.4) * s.friction,
        "neutral": r.uniform(-0.5, 0.5),
    },
    "cubic_stiffness": lambda r, s, u: {
        "coefficient": r.uniform(1.0, 2.0) * s.friction,
        "neutral": r.uniform(-0.2, 0.2),
    },
    "inertia": lambda r, s, u: {"amount": r.uniform(0.25, 0.7) * s.inertia},
    "coupling": _coupling,
    "elasticity": _elasticity,
    "backlash": _backlash,
    "hysteresis": _hysteresis,
    "ripple": lambda r, s, u: {
        # 3 had 1.46 periods in a motion of the planar arm, and no wave is told from less than 1.5
        "order": float(r.choice((5, 4, 6, 8, 12))),
        "amplitude": r.uniform(0.25, 0.6) * s.friction,
        "phase": _angle(r),
    },
    "torque_gain": lambda r, s, u: {"ratio": _sign(r) * r.uniform(0.1, 0.25)},
    "torque_offset": lambda r, s, u: {"level": _sign(r) * r.uniform(0.25, 0.6) * s.friction},
    "dead_zone": lambda r, s, u: {"width": r.uniform(0.3, 0.6) * s.friction},
    "saturation": lambda r, s, u: {"level": r.uniform(0.6, 0.85) * s.torque},
    "lag": lambda r, s, u: {"time_constant": r.uniform(0.004, 0.015)},
    "delay": lambda r, s, u: {"time": r.randint(2, 7) * u.period},
    "encoder_eccentricity": lambda r, s, u: {
        "amplitude": r.uniform(0.01, 0.03),
        "phase": _angle(r),
    },
    "disturbance": lambda r, s, u: {
        "level": _sign(r) * r.uniform(0.6, 1.2) * s.friction,
        "begin": r.uniform(0.8, 2.0),
        "duration": r.uniform(0.5, 1.5),
    },
    "foreign": lambda r, s, u: {
        "law": float(r.randrange(3)),
        "amplitude": r.uniform(0.6, 1.2) * s.friction,
    },
    "payload": lambda r, s, u: dict(
        zip(("mass", "x", "y", "z"), (r.uniform(*span) for span in u.payload), strict=True)
    ),
}

INERTIAL = ("inertia", "elasticity", "backlash")
# What a plain seed draws from: the named physics. These come when asked for by effect=.
NAMED = tuple(name for name in DRAWS if name not in ("disturbance", "foreign", "payload"))


def draw_effect(r: random.Random, machine: str, effect: str, joint: int) -> ConcealedEffect:
    """One effect of random size on one joint.

    Parameters
    ----------
    r : random.Random
        Source of randomness.
    machine, effect : str
        Names.
    joint : int
        1-based.

    Returns
    -------
    ConcealedEffect
        Parameters rounded to four digits, so that the truth reads well.

    Examples
    --------
    >>> draw_effect(random.Random(1), "imi_planar", "coulomb", 2).parameters["level"] < 2.35
    True
    """
    usual = MACHINES[machine]
    if not 1 <= joint <= len(usual.joints):
        raise Refused(f"concealed: joint {joint}; {machine} has joints 1 to {len(usual.joints)}")
    drawn = dict(DRAWS[effect](r, usual.joints[joint - 1], usual))
    if effect == "coupling":
        drawn["from_joint"] = float(
            r.choice([j for j in range(1, len(usual.joints) + 1) if j != joint])
        )
    return ConcealedEffect(effect, joint, {k: float(f"{v:.4g}") for k, v in drawn.items()})


def _payload(r: random.Random) -> tuple[ConcealedEffect, ...]:
    """A weight clamped to the bar of the pendulum: inertia and gravity together, m l^2 and m g l.
    """
    mass, arm = r.uniform(0.03, 0.08), r.uniform(0.08, 0.16)  # kg, m
    return (
        ConcealedEffect("inertia", 1, {"amount": float(f"{mass * arm**2:.4g}")}),
        ConcealedEffect("gravity", 1, {"torque": float(f"{9.81 * mass * arm:.4g}"), "angle": 0.0}),
    )


def _joints(usual: Usual, effect: str) -> tuple[int, ...]:
    """Joints on which an effect can be felt."""
    if effect == "payload":
        return (len(usual.joints),)
    return (
        usual.heavy
        if effect in INERTIAL and usual.heavy
        else tuple(range(1, len(usual.joints) + 1))
    )


def draw(
    machine: str,
    seed: int,
    effect: str | None = None,
    joint: int | None = None,
    count: int = 1,
    friction: str = "full",
) -> Concealed:
    """Effects drawn by seed: the same seed gives the same effects, on every computer.

    Parameters
    ----------
    machine : str
        A shipped machine.
    seed : int
        Any whole number.
    effect : str, optional
        Only this effect, or one of several: "ripple/coupling"; else any named one that the machine
        can carry. On the pendulum "payload" is inertia and gravity, elsewhere a mass on the last
        link.
    joint : int, optional
        1-based; else any.
    count : int
        Number of effects, all different. 0: nothing is concealed.
    friction : {"full", "plain"}
        The machine's own friction.

    Returns
    -------
    Concealed
        Sealed with a nonce that is not drawn by the seed.

    Raises
    ------
    Refused
        Unknown machine, effect or joint, or more effects than there are.

    Examples
    --------
    >>> [e.effect for e in draw("pendulum", 3, effect="ripple").effects]
    ['ripple']
    """
    if machine not in MACHINES:
        raise Refused(
            f"concealed: nothing can be drawn for {machine!r}, only for {', '.join(MACHINES)}; give"
            " a file"
        )
    usual = MACHINES[machine]
    r = random.Random(f"{machine}/{seed}")
    if effect == "payload" and machine == "pendulum":
        return Concealed(machine, _payload(r), f"seed:{seed}", friction)
    pool = (
        effect.split("/")
        if effect is not None
        else [name for name in NAMED if name not in usual.excluded]
    )
    for name in pool:
        if name not in DRAWS or name in usual.excluded:
            choice = [name for name in DRAWS if name not in usual.excluded]
            raise Refused(
                f"concealed: {machine} cannot carry {name!r}; {did_you_mean(name, choice)}"
            )
    if not 0 <= count <= len(pool):
        raise Refused(f"concealed: count {count}; 0 to {len(pool)} different effects can be drawn")
    chosen = r.sample(pool, count)
    effects = tuple(
        draw_effect(r, machine, name, joint or r.choice(_joints(usual, name))) for name in chosen
    )
    return Concealed(machine, effects, f"seed:{seed}", friction)


def draw_from_text(spec: str, machine: str) -> Concealed:
    """The form of the command line:
    ``seed:N[,effect=NAME[/NAME…]][,joint=J][,count=K][,friction=plain]``.

    Raises
    ------
    Refused
        Not of this form.

    Examples
    --------
    >>> draw_from_text("seed:5,effect=delay,joint=2", "imi_planar").effects[0].joint
    2
    """
    head, *rest = spec.removeprefix("seed:").split(",")
    options = dict(part.partition("=")[::2] for part in rest)
    unknown = set(options) - {"effect", "joint", "count", "friction"}
    form = "seed:N[,effect=NAME[/NAME…]][,joint=J][,count=K][,friction=plain]"
    if unknown:
        raise Refused(f"concealed: {', '.join(sorted(unknown))} in {spec!r}; expected {form}")
    try:
        seed = random.SystemRandom().randrange(2**31) if head == "random" else int(head)
        joint = int(options["joint"]) if "joint" in options else None
        count = int(options.get("count", 1))
    except ValueError as error:
        raise Refused(f"concealed: {spec!r}: expected {form}") from error
    return draw(machine, seed, options.get("effect"), joint, count, options.get("friction", "full"))
