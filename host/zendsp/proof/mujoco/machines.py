"""Five machines for MuJoCo: motor and link, cart, two links, a six-joint and a seven-joint arm.

Masses and lengths of the arms are near published figures (Universal Robots UR5, KUKA LBR iiwa 14);
their bodies are cylinders.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from zendsp.proof.draft import Array, Concealed, Term
from zendsp.proof.mujoco.chain import HARD, SOFT, STANDARD, Joint, Link, World, rod

Rng = np.random.Generator
Torque = Callable[
    [float, float, float, float], float
]  # (t, q, v, motor torque) -> torque on the joint
Law = Callable[
    [float], Torque
]  # substep s -> a torque with its own states, fresh for every recording
INTEGRATORS = ("RK4", "implicitfast")


@dataclass
class Bench:
    """One case in the making: the machine, its controller, its sensor, and what is concealed."""

    machine: str
    kind: str  # of [mechanism] in the given model
    links: list[Link]
    joints: list[Joint]
    sample_time: float
    seconds: float
    amplitude: list[float]
    speed: list[float]
    centre: list[float]
    limit: list[float]  # of the command
    resolution: list[float]
    bandwidth: float  # rad/s, of the position loop
    damping: float
    controller: str  # pd | cascade | computed
    integrator: str
    substep: float = 1e-4
    feedforward: bool = False
    velocity_filter: float = 0.004
    noise: float = 0.0  # share of the resolution
    nuisance: float = 0.0  # coloured torque, share of the torque's RMS
    gravity: float = 0.0  # of the given rotary model, N m
    world: World = field(default_factory=World)
    known_delay: float = 0.0
    nominal: list[Link] = field(
        default_factory=list
    )  # bodies that the controller and the given model know
    nominal_armature: list[float] = field(default_factory=list)
    nominal_damping: list[float] = field(default_factory=list)
    nominal_dry: list[float] = field(default_factory=list)
    stated_gain: list[float] = field(default_factory=list)
    laws: list[tuple[int, Law]] = field(default_factory=list)  # torques that MuJoCo does not have
    twists: list[tuple[int, Law]] = field(default_factory=list)  # the same between rotor and link
    motion: tuple[Callable[[float, Array, Array], Array], float] | None = (
        None  # foreign, on all joints
    )
    pushes: list[tuple[int, float, float, float]] = field(
        default_factory=list
    )  # joint, from, to, torque
    sensor: list[tuple[int, float, float, float]] = field(
        default_factory=list
    )  # joint, order, amplitude, phase
    concealed: list[Concealed] = field(default_factory=list)
    hidden: list[set[str]] = field(
        default_factory=list
    )  # friction laws that the given model lacks, by joint
    known: list[Term] = field(default_factory=list)
    fixed: bool = False  # inertial figures are not free
    also_true: set[str] = field(default_factory=set)
    faults: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    train_shape: str = "multisine"
    heldout_shape: str = "sines"

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def freeze(self) -> Bench:
        """What the controller and the given model know is what the machine is now."""
        self.nominal = list(self.links)
        self.nominal_armature = [j.armature for j in self.joints]
        self.nominal_damping = [j.damping for j in self.joints]
        self.nominal_dry = [j.dry for j in self.joints]
        self.stated_gain = [j.gain for j in self.joints]
        self.hidden = [set() for _ in self.joints]
        return self


def _log_uniform(rng: Rng, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def dry(rng: Rng, joints: list[Joint], levels: list[float], flavour: str) -> None:
    """Dry friction that the given model has, too: none, hard, or as soft as MuJoCo comes."""
    for joint, level in zip(joints, levels, strict=True):
        if flavour == "none":
            continue
        joint.dry = level
        joint.solref, joint.solimp = hardness(flavour == "soft")


def hardness(soft: bool) -> tuple[tuple[float, float], tuple[float, float, float]]:
    """Solver parameters of dry friction: it sticks, or it creeps below its level."""
    return (STANDARD, SOFT) if soft else ((5e-4, 1.0), HARD)


def harden(b: Bench) -> None:
    """Make the dry friction that is known stick: what is soft is not the Coulomb of the given
    model.
    """
    for joint in b.joints:
        joint.solref, joint.solimp = hardness(False)
    b.also_true.discard("presliding")
    b.notes = [note.replace("soft", "hard") for note in b.notes]


def _drawn(rng: Rng, shapes: tuple[str, ...]) -> tuple[str, str]:
    return str(rng.choice(shapes)), str(rng.choice(shapes))


def _flavour_of(rng: Rng) -> str:
    return str(rng.choice(["none", "hard", "soft"], p=[0.4, 0.5, 0.1]))


def _loop_of(rng: Rng, cascade: bool = True) -> str:
    return str(rng.choice(["pd", "computed", "cascade"] if cascade else ["pd", "computed"]))


def joint(rng: Rng) -> Bench:
    """A motor and a link that hangs from it: rotor inertia, gravity, 10 to 20 s at 1 kHz or 500 Hz.
    """
    mass, length, radius = _log_uniform(rng, 0.1, 1.0), rng.uniform(0.12, 0.4), 0.01
    link = replace(rod(mass, length, radius, 2).moved((0.0, 0.0, -length)), axis=(0.0, -1.0, 0.0))
    swung = mass * (length**2 / 3 + radius**2 / 4)
    rotor = swung * rng.uniform(0.2, 1.0)
    inertia = swung + rotor
    flat = rng.random() < 0.3  # turns about a vertical axis: no gravity
    gravity = 0.0 if flat else mass * 9.81 * length / 2
    speed, amplitude = rng.uniform(4.0, 10.0), rng.uniform(1.2, 2.6)
    felt = inertia * speed * 4 + 0.5 * gravity
    bits = int(rng.choice([12, 14, 16, 18]))
    resolution = 2 * np.pi / 2**bits
    flavour = _flavour_of(rng)
    j = Joint(armature=rotor, damping=felt / speed * rng.uniform(0.05, 0.15))
    dry(rng, [j], [felt * rng.uniform(0.06, 0.15)], flavour)
    train, held = _drawn(rng, ("multisine", "mixed", "sines", "triangles", "chirp", "moves"))
    kind = _loop_of(rng)
    # a count of the encoder must not shake the motor: slower loops behind coarse encoders
    fast = min(rng.uniform(12.0, 25.0), np.sqrt(0.1 * felt * 0.006 / (resolution * inertia * 1.0)))
    return Bench(
        "mj_joint", "rotary", [link], [j], float(rng.choice([1e-3, 2e-3], p=[0.75, 0.25])),
        float(rng.choice([10.0, 15.0, 20.0])), [amplitude], [speed], [0.0], [round(8 * felt, 3)],
        [resolution], float(fast), 0.7, kind, str(rng.choice(INTEGRATORS)),
        feedforward=bool(rng.random() < 0.5), velocity_filter=0.005,
        noise=float(rng.choice([0.0, 0.5, 1.0])), gravity=gravity,
        world=World(gravity=(0.0, -9.81, 0.0) if flat else (0.0, 0.0, -9.81)),
        train_shape=train, heldout_shape=held, notes=[f"dry friction that is known: {flavour}"],
        also_true={"presliding"} if flavour == "soft" else set(),
    ).freeze()  # fmt: skip


def cart(rng: Rng) -> Bench:
    """A mass on a rail, pulled by a motor: force per volt, 10 to 20 s at 1 kHz or 500 Hz."""
    mass = _log_uniform(rng, 1.0, 60.0)
    rotor = mass * rng.uniform(0.05, 0.4)
    body = Link(
        (0, 0, 0), (1.0, 0.0, 0.0), mass, (0, 0, 0), (0.1, 0.1, 0.1, 0.0, 0.0, 0.0), slides=True
    )
    speed = rng.uniform(0.3, 0.8)
    felt = (mass + rotor) * speed * 4
    flavour = _flavour_of(rng)
    gain = felt / rng.uniform(2.0, 5.0)
    j = Joint(armature=rotor, damping=felt / speed * rng.uniform(0.05, 0.2), gain=gain)
    dry(rng, [j], [felt * rng.uniform(0.06, 0.15)], flavour)
    train, held = _drawn(rng, ("multisine", "mixed", "sines", "triangles", "moves"))
    return Bench(
        "mj_cart",
        "linear",
        [body],
        [j],
        float(rng.choice([1e-3, 2e-3], p=[0.75, 0.25])),
        float(rng.choice([10.0, 15.0, 20.0])),
        [rng.uniform(0.15, 0.4)],
        [speed],
        [0.0],
        [round(8 * felt / gain, 3)],
        [float(rng.choice([1e-5, 2e-6, 5e-7]))],
        rng.uniform(15.0, 30.0),
        0.7,
        _loop_of(rng),
        str(rng.choice(INTEGRATORS)),
        feedforward=bool(rng.random() < 0.5),
        noise=float(rng.choice([0.0, 0.5, 1.0])),
        train_shape=train,
        heldout_shape=held,
        notes=[f"dry friction that is known: {flavour}"],
        also_true={"presliding"} if flavour == "soft" else set(),
    ).freeze()


def planar2r(rng: Rng) -> Bench:
    """Two links in a horizontal plane, 15 s at 1 kHz or 500 Hz."""
    m1, m2 = rng.uniform(2.0, 6.0), rng.uniform(1.0, 3.0)
    l1, l2 = rng.uniform(0.3, 0.5), rng.uniform(0.25, 0.45)
    first = rod(m1, l1, 0.04, 0)
    second = replace(rod(m2, l2, 0.03, 0), place=(l1, 0.0, 0.0))
    size = [m1 * l1**2 / 3 + m2 * l1**2, m2 * l2**2 / 3]
    speed = [rng.uniform(3.0, 5.0), rng.uniform(3.0, 6.0)]
    felt = [4 * s * v for s, v in zip(size, speed, strict=True)]
    flavour = _flavour_of(rng)
    joints = [
        Joint(damping=f / v * rng.uniform(0.05, 0.15)) for f, v in zip(felt, speed, strict=True)
    ]
    dry(rng, joints, [f * rng.uniform(0.06, 0.15) for f in felt], flavour)
    train, held = _drawn(rng, ("multisine", "mixed", "sines", "moves"))
    return Bench(
        "mj_planar2r",
        "planar2r",
        [first, second],
        joints,
        float(rng.choice([1e-3, 2e-3])),
        15.0,
        [rng.uniform(1.0, 2.0), rng.uniform(1.0, 2.0)],
        speed,
        [0.0, 0.0],
        [round(8 * f, 2) for f in felt],
        [2 * np.pi / 2**17] * 2,
        rng.uniform(10.0, 18.0),
        0.8,
        _loop_of(rng, cascade=False),
        str(rng.choice(INTEGRATORS)),
        feedforward=bool(rng.random() < 0.5),
        noise=float(rng.choice([0.0, 0.5])),
        train_shape=train,
        heldout_shape=held,
        notes=[f"dry friction that is known: {flavour}"],
        also_true={"presliding"} if flavour == "soft" else set(),
    ).freeze()


Z, Y = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)


def arm(
    rng: Rng, name: str, links: list[Link], armature: tuple[float, ...], levels: tuple[float, ...],
    centre: tuple[float, ...], limit: tuple[float, ...],
) -> Bench:  # fmt: skip
    """An arm with torque control: 12 s at 500 or 250 Hz, sometimes 100 Hz."""
    n = len(links)
    spread = [float(x) for x in rng.uniform(0.7, 1.3, n)]
    joints = [
        Joint(armature=a, damping=1.2 * level * s)
        for a, level, s in zip(armature, levels, spread, strict=True)
    ]
    flavour = _flavour_of(rng)
    dry(
        rng,
        joints,
        [level * s for level, s in zip(levels, rng.uniform(0.7, 1.3, n), strict=True)],
        flavour,
    )
    dt = float(rng.choice([2e-3, 4e-3, 1e-2], p=[0.6, 0.3, 0.1]))
    slow = dt > 5e-3
    train, held = _drawn(rng, ("multisine", "sines", "mixed", "moves"))
    bench = Bench(
        name,
        "urdf",
        links,
        joints,
        dt,
        20.0 if slow else 12.0,
        [float(x) for x in rng.uniform(0.4, 0.9, n)],
        [float(x) for x in rng.uniform(1.0, 2.2, n)],
        list(centre),
        list(limit),
        [2 * np.pi / 2**19] * n,
        6.0 if slow else rng.uniform(9.0, 15.0),
        0.9,
        _loop_of(rng, cascade=False),
        str(rng.choice(INTEGRATORS)),
        feedforward=True,
        velocity_filter=2 * dt,
        noise=float(rng.choice([0.0, 0.5])),
        train_shape=train,
        heldout_shape=held,
        notes=[f"dry friction that is known: {flavour}"],
        also_true={"presliding"} if flavour == "soft" else set(),
    )
    bench.known = [Term("inertia", k + 1, {"amount": a}) for k, a in enumerate(armature)]
    return bench.freeze()


def arm6(rng: Rng) -> Bench:
    """Six joints with the masses and lengths of a UR5."""
    links = [
        replace(rod(3.7, 0.15, 0.06, 2), place=(0.0, 0.0, 0.089), axis=Z),
        replace(rod(8.393, 0.425, 0.054, 0), place=(0.0, 0.136, 0.0), axis=Y),
        replace(rod(2.275, 0.392, 0.06, 0), place=(0.425, -0.12, 0.0), axis=Y),
        replace(rod(1.219, 0.12, 0.045, 1), place=(0.392, 0.0, 0.0), axis=Y),
        replace(rod(1.219, -0.12, 0.045, 2), place=(0.0, 0.093, 0.0), axis=Z),
        replace(rod(0.1879, 0.08, 0.0375, 1), place=(0.0, 0.0, -0.095), axis=Y),
    ]
    return arm(
        rng, "mj_arm6", links, (0.3, 0.3, 0.2, 0.08, 0.08, 0.06), (5.0, 6.0, 4.0, 1.2, 1.2, 0.8),
        (0.0, -0.9, 1.2, -0.6, 0.4, 0.0), (300.0, 300.0, 300.0, 56.0, 56.0, 56.0),
    )  # fmt: skip


def arm7(rng: Rng) -> Bench:
    """Seven joints with the masses and lengths of an LBR iiwa 14."""
    links = [
        replace(rod(4.0, 0.2, 0.06, 2), place=(0.0, 0.0, 0.1575), axis=Z),
        replace(rod(4.0, 0.2, 0.06, 2), place=(0.0, 0.0, 0.2025), axis=Y),
        replace(rod(3.0, 0.215, 0.055, 2), place=(0.0, 0.0, 0.2045), axis=Z),
        replace(rod(2.7, 0.18, 0.055, 2), place=(0.0, 0.0, 0.2155), axis=(0.0, -1.0, 0.0)),
        replace(rod(1.7, 0.215, 0.05, 2), place=(0.0, 0.0, 0.1845), axis=Z),
        replace(rod(1.8, 0.08, 0.045, 2), place=(0.0, 0.06, 0.2155), axis=Y),
        replace(rod(0.3, 0.05, 0.04, 2), place=(0.0, -0.06, 0.081), axis=Z),
    ]
    return arm(
        rng, "mj_arm7", links, (0.3, 0.3, 0.2, 0.2, 0.1, 0.08, 0.05),
        (4.0, 4.0, 2.5, 2.5, 1.2, 1.0, 0.5), (0.0, 0.6, 0.0, 1.4, 0.0, 0.8, 0.0),
        (320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0),
    )  # fmt: skip


MACHINES: dict[str, Callable[[Rng], Bench]] = {
    "mj_joint": joint, "mj_cart": cart, "mj_planar2r": planar2r, "mj_arm6": arm6, "mj_arm7": arm7,
}
