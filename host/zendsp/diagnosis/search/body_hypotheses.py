"""The possible errors of a machine's bodies and their look-alikes, each a hypothesis with numbers
and a cost.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from zendsp.physics.model import Model, Quantity, Term
from zendsp.physics.robots.bodies import Links


@dataclass(frozen=True)
class BodyLimits:
    """The limits and thresholds of the search for bodies."""

    # rad/s of the observers: fast, since much is missing when bodies are looked for
    bandwidth: float = 64.0
    slowest: float = 8.0  # where fast ones see more of something else than of a body
    chance: float = 0.05  # probability that any of all explanations gains enough by chance
    block: float = 1.0  # s: longer than an observer's memory and a swing of an arm
    blocks: int = 16  # least number of blocks; shorter ones otherwise
    # of the RMS speed: a slower joint may stick and says nothing about its load
    still: float = 0.05
    memory: float = 0.1  # s for which an observer remembers that a joint stuck
    by_load: bool = True  # dry friction may grow with a joint's load
    own: bool = True  # each joint may have a rotor and a constant torque that its model has not
    # standard deviations over the blocks within which two explanations are as good
    tie: float = 2.5
    # the same for two sets of numbers of one link: too few numbers lead to faults of single joints
    same_link: float = 1.5
    share: float = 0.03  # of the best gain: an explanation that is nearer is as good
    # the same for a body against a common gain: payloads of 0.2 and 1.2 kg on a planar arm, seen by
    # their inertia alone, gained 4 and 5 % less than the gain
    blunt: float = 0.1
    sure: float = 3.0  # standard deviations over the blocks: least of an explanation
    part: float = 0.2  # least part to be removed of what some joint leaves
    # standard deviations from which a smaller part suffices, since slightly wrong friction leaves
    # more
    clear: float = 3.5
    little: float = 0.03
    least: float = 0.01  # of some joint's RMS torque: smaller bodies are not looked for
    bodies: int = 3  # most wrong bodies of a machine
    # m from a link's centre of mass: a nearer body is the link's own mass; from its joint's axis: a
    # nearer one may be an inertia of the joint before
    same: float = 0.02
    own_mass: float = 0.5  # of a link's mass: a larger error is a payload
    shown: float = 2.0  # standard deviations: a mass gets a surer inertia of its own
    spread: float = 0.3  # m: no payload's radius of gyration is larger
    density: float = 1000.0  # kg/m^3 of a payload: a ball of water, between a gripper and a box
    reach: float = 1.0  # m from its link's centre of mass: farthest centre of a payload
    gain: float = 0.5  # largest error of an actuator's gain
    constant: float = 0.05  # relative standard deviation of the torque constants that makers state
    gains: float = 0.2  # largest common error of all gains: four times that
    halvings: int = 6  # of that error, until the body's inertia is possible
    step: float = 1e-6  # relative, of numerical derivatives
    # of a free parameter of the mechanism: a larger change is no calibration
    calibrated: float = 0.15
    stated: float = 0.045  # relative standard deviation of such a parameter that states none
    far: float = 3.0  # standard deviations that the model states, likewise
    rounds: int = 3  # of estimating again around the estimate before
    moves: float = 0.3  # standard deviations: an estimate that moves less has converged
    # a mass with an inertia of its own is still determined if its standard deviation is below this
    # many of that without it, or below this part of the mass
    blurred: float = 3.0
    of_mass: float = 0.01
    # least part of the evidence for that inertia which no rotors imitate: two joints at right
    # angles had 4e-6 to 1.5e-4, all other arms 0.1 and more
    no_rotor: float = 3e-3
    settled: float = 1e-3  # deviance: a fit ends with a step that gains less
    damped: float = 1e6  # damping at which a fit gives up
    # m from the link's origin: start values of a payload's centre
    starts: tuple[float, ...] = (0.05, 0.15, 0.4)


LIMITS = BodyLimits()
# further columns of one joint, as rivals of a body: gain, sin q, cos q, q, sin 2q, cos 2q
OWN_COLUMNS = 6
COM = ("com_x", "com_y", "com_z")
OF_A_LINK = ("payload", "body")  # hypotheses about the ten numbers of one link
# cost of an explanation where several are as good: fewest numbers and most frequent cause first
COST = {
    "payload": 4.0,
    "body": 1.0,
    "base_tilt": 1.0,
    "torque_gain": 1.0,
    "inertia": 1.0,
    "gravity": 3.0,
    "stiffness": 3.0,
    "unknown": 8.0,
    "zero": 7.0,  # a body that predicts as well is stated, as indistinguishable from this
}
TOOL = 2.0  # of a payload at the end of a chain
# of causes that act on the whole machine: another gravity, one factor for all gains, and the
# machine's own numbers beyond their tolerance
RARE = 6.0


@dataclass(frozen=True)
class Hypothesis:
    """An explanation of what all joints leave.

    Attributes
    ----------
    effect : str
        Name in the library, or ``gravity_scale`` (g times a factor), ``calibration`` (the
        mechanism's own free parameters), ``zero`` (of a joint's sensor), ``nothing``;
        ``unknown`` is any torque of one joint's own position and command.
    joint : int
        1-based; the last joint that moves the body. 0: all joints.
    body : str
        Name of the link, empty where it is about none.
    free : tuple of str
        Names of its numbers.
    """

    effect: str
    joint: int = 0
    body: str = ""
    free: tuple[str, ...] = ()
    cost: float = 0.0

    @property
    def of_bodies(self) -> bool:
        """Whether it is about bodies or gravity, and not a rival of those."""
        return self.effect in ("payload", "body", "base_tilt")

    @property
    def name(self) -> str:
        """Name for a list of indistinguishable effects."""
        if self.effect == "torque_gain":
            return (
                f"torque_gain of joint {self.joint}" if self.joint else "torque_gain of all joints"
            )
        if self.effect == "zero":
            return f"another zero of joint {self.joint}" if self.joint else "other zeros"
        return self.effect + (
            f" of {self.body}" if self.body else f" of joint {self.joint}" if self.joint else ""
        )


def calibrated(model: Model) -> tuple[str, ...]:
    """The mechanism parameters of a model that may be calibrated."""
    return tuple(
        key for key, items in model.mechanism.items() if any(i.free and i.value for i in items)
    )


def zeros(joints: Sequence[int], model: Model) -> Hypothesis:
    """Other zeros of some joints (from 1), beside the mechanism's own free parameters."""
    free = (*(f"zero{joint}" for joint in joints), *calibrated(model))
    only = joints[0] if len(joints) == 1 else 0
    return Hypothesis("zero", only, "", free, COST["zero"] + len(joints) - 1)


def turned_joints(h: Hypothesis) -> list[int]:
    """The joints (from 1) whose zeros a hypothesis moves by its first numbers, in this order."""
    return [int(key.removeprefix("zero")) for key in h.free if key.startswith("zero")]


# of the largest torque that another zero causes: rounding of its difference over a small turn is a
# ten-thousandth of it
UNFELT_ZERO = 1e-6


def homed(links: Links) -> list[int]:
    """The joints (from 1) whose zero some joint feels: not that of an upright first axis, nor that
    of an axis through the centre of all that it turns. (By rounding alone such joints of an arm
    were 4e8 rad beside their zeros, and its recordings refused.)
    """
    sizes = np.abs(links.zeros({}, ())).max(axis=(0, 2), initial=0.0)
    least = UNFELT_ZERO * float(sizes.max(initial=0.0))
    return [k + 1 for k in links.turning if sizes[k] > least]


# for each coordinate of a link's centre, those of its ten ``NUMBERS`` that contain it
_HOLDS = {"com_x": (1, 5, 6, 7, 8), "com_y": (2, 4, 6, 7, 9), "com_z": (3, 4, 5, 8, 9)}
UNFELT = 1e-9  # of the largest column of a link: rounding is 1e-16 of it


def felt(links: Links, link: int) -> tuple[str, ...]:
    """The coordinates of a link's centre that some joint feels. With parallel axes, a shift along
    them acts on no joint.
    """
    sizes = np.zeros(10)
    for joint in range(len(links.bodies)):
        if links.moves(joint, link):
            sizes = np.maximum(sizes, np.abs(links.columns(joint, link)[1]).max(axis=1))
    seen = sizes > UNFELT * float(sizes.max())
    return tuple(key for key, at in _HOLDS.items() if seen[list(at)].any())


# rad, a small tilt. Out of the plane of an upright arm it changes the torques only by the square of
# the angle: by less than UNTURNED of what the same tilt in the plane does
TILT = 1e-3
UNTURNED = 0.01


def turned(links: Links) -> tuple[str, ...]:
    """The axes of the base about which some joint feels a tilt."""
    sizes = {}
    for key in ("angle_x", "angle_y"):
        tilt = [Term("base_tilt", 1, {key: Quantity(TILT)})]
        felt = [links.change(tilt, joint).bias for joint in range(len(links.bodies))]
        sizes[key] = max(float(np.abs(bias).max()) for bias in felt)
    return tuple(key for key, size in sizes.items() if size > UNTURNED * max(sizes.values()))


def hypotheses(model: Model, links: Links) -> list[Hypothesis]:
    """All hypotheses that are tried."""
    out: list[Hypothesis] = []
    ends = {k for k in range(len(links.bodies)) if all(b.parent != k for b in links.bodies)}
    flat = model.kind == "planar2r"
    for k, b in enumerate(links.bodies):
        # its parameters have no centres beside the links' lines; a load may have
        com = ("com_x",) if flat else felt(links, k)
        free = ("mass", *com)
        cost = TOOL if k in ends else COST["payload"]
        out.append(Hypothesis("payload", k + 1, b.name, free, cost))
        if flat and links.moves(0, k) and k > 0:
            out.append(Hypothesis("payload", k + 1, b.name, (*free, "com_y"), cost + 1))
        if b.mass > 0:
            out.append(Hypothesis("body", k + 1, b.name, ("mass",), COST["body"] + 1))
            if com:
                out.append(Hypothesis("body", k + 1, b.name, com, COST["body"] + len(com)))
                out.append(Hypothesis("body", k + 1, b.name, free, COST["body"] + 1 + len(com)))
    if any(b.mass > 0 for b in links.bodies) and np.any(links.gravity):
        axes = turned(links)
        cost = COST["base_tilt"] + len(axes)
        out += [Hypothesis("base_tilt", free=axes, cost=cost)] if axes else []
        out.append(Hypothesis("gravity_scale", free=("ratio",), cost=RARE))
    if keys := calibrated(model):
        out.append(Hypothesis("calibration", free=keys, cost=RARE))
    out.append(Hypothesis("torque_gain", free=("ratio",), cost=RARE))
    if flat:  # elsewhere the rotors of all joints are free
        out.append(Hypothesis("inertia", 1, "", ("amount",), COST["inertia"]))
    turning = [2] if flat else homed(links)
    out += [zeros([joint], model) for joint in turning]
    out += [zeros(turning, model)] if len(turning) > 1 else []
    for j in range(1, len(links.bodies) + 1):
        for effect, free in (
            ("torque_gain", ("ratio",)),
            ("gravity", ("sine", "cosine")),
            ("stiffness", ("coefficient",)),
            ("unknown", tuple(f"c{i}" for i in range(OWN_COLUMNS))),
        ):
            out.append(Hypothesis(effect, j, "", free, COST[effect]))
    return out
