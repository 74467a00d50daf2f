"""Grids, bounds and start values that several effects share. All SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from zendsp.physics.effects.base import Along, Array, Facts, Numbers, Parameter

LEAST_ORDER, HARMONICS = 2, 60  # screened a turn: once per turn is gravity
PERIODS = 1.5  # of a wave within the motion, where no turn says how often it repeats
# damping ratio of a load: rubber has 0.1, MuJoCo's constraints 1; a fit that needs more imitates
# something else
OVERDAMPED = 2.0
OFF_CENTRE = 0.06  # of the radius of an encoder disc
DAMPING = 0.3  # of √(stiffness load): a damping ratio of 0.15 of the load on its spring
SLOWEST, FASTEST = 0.5, 200.0  # Hz: a resonance beyond is not seen in a recording

Limits = Callable[[Facts], tuple[float, float]]


def orders(facts: Facts) -> Sequence[float]:
    """Repeats to screen, 1/rad or 1/m: whole ones a turn from two on, finely spaced on an axis."""
    if facts.slides:
        return [math.pi / facts.scale.position * i for i in range(LEAST_ORDER, 320)]
    return [float(i) for i in range(LEAST_ORDER, HARMONICS + 1)]


def order_limits(turn: float, *, whole: bool = True) -> Limits:
    """Repeats within a motion that can be told: ``PERIODS`` of them along an axis; at a rotary
    joint ``turn`` each turn, and with ``whole`` as many as along an axis where it turns less, and
    where that are fewer.
    """

    def limits(facts: Facts) -> tuple[float, float]:
        span = facts.scale.position
        least = PERIODS * 2 * math.pi / span
        if facts.slides or (whole and span < 2 * math.pi):
            return least, math.inf
        return min(turn, least) if whole else turn, math.inf

    return limits


def of_speed(*shares: float) -> Callable[[Facts], Sequence[float]]:
    """Shares of the speed that 5 % of the samples exceed."""
    return lambda facts: [share * facts.fast for share in shares]


def of_command(*shares: float) -> Callable[[Facts], Sequence[float]]:
    """Shares of the command that 0.1 % of the samples exceed."""
    return lambda facts: [share * facts.strong for share in shares]


def command_limits(facts: Facts) -> tuple[float, float]:
    """From nothing to beyond the largest command."""
    return 0.0, 1.2 * facts.strongest


def around_centre(*shares: float) -> Callable[[Facts], Sequence[float]]:
    """Positions, as shares of the motion's range from its middle."""
    return lambda facts: [facts.centre + share * facts.scale.position for share in shares]


def neutral_limits(facts: Facts) -> tuple[float, float]:
    """A neutral point may lie outside of the motion, but not far."""
    return facts.centre - 3 * facts.scale.position, facts.centre + 3 * facts.scale.position


def near(power: int) -> Callable[[Facts, Numbers], Numbers]:
    """Another start of a spring: neutral in the middle of the motion, or at its edge if the neutral
    point was far outside.

    What screens as a weak spring with a distant neutral point may be a strong one with a near one:
    a constant torque and a stiffness lie in one narrow valley, along which a fit hardly moves.
    ``power``: exponent of the deflection in the torque.
    """

    def other(facts: Facts, values: Numbers) -> Numbers:
        reach = 0.5 * facts.scale.position
        away = values["neutral"] - facts.centre
        far = abs(away) > reach
        return {
            "neutral": facts.centre + (math.copysign(reach, away) if far else 0.0),
            "coefficient": values["coefficient"]
            * (abs(away) / reach + (0.0 if far else 1.0)) ** power,
        }

    return other


def slow_limits(facts: Facts) -> tuple[float, float]:
    """Limits of time constants that a recording of this length can show, s.

    A drift acts in most of a recording: its grid begins at a tenth of it. (Robot brakes: 0.34 s of
    10 s for a KUKA. From a twentieth on, two of its axes had a friction that falls to a quarter
    within half a second.) A number at its limit says nothing, so the limit lies below the grid: at
    the smallest size that is stated a time constant of a tenth comes out within 8 %.
    """
    return 0.07 * facts.scale.seconds, 5.0 * facts.scale.seconds


def resonance(facts: Facts, hertz: float, share: float) -> float:
    """The stiffness with which a load of this share of the inertia rings at a frequency, N m/rad or
    N/m.
    """
    return (2 * math.pi * hertz) ** 2 * facts.inertia * share * (1 - share)


def _fastest(facts: Facts) -> float:
    """The fastest oscillation that the row spacing can show, rad/s."""
    return min(2 * math.pi * FASTEST, math.pi / facts.sample_time)


def transmission_limits(facts: Facts) -> tuple[float, float]:
    """Stiffnesses whose resonance a recording can show."""
    inertia = facts.scale.inertia
    return 0.05 * inertia * (2 * math.pi * SLOWEST) ** 2, 0.25 * inertia * _fastest(facts) ** 2


def stiffening_limits(facts: Facts) -> tuple[float, float]:
    """The same of the cubic term, at the typical torque."""
    return 0.0, transmission_limits(facts)[1] ** 3 / facts.scale.torque**2


def viscous_limits(facts: Facts) -> tuple[float, float]:
    """Limits of viscous friction: at most the typical torque at a hundredth of the typical speed,
    above which a joint hardly moves.
    """
    return 0.0, 100.0 * facts.scale.torque / facts.scale.speed


def transmission_damping_limits(facts: Facts) -> tuple[float, float]:
    """Limits of a transmission's damping, from zero to one that does not oscillate."""
    return 0.0, 0.4 * facts.scale.inertia * _fastest(facts)


def swings(p: Numbers) -> bool:
    """Whether a load is on a spring rather than a dashpot: damped at most twice critically, and no
    slower than a recording can show.
    """
    critical = 2.0 * math.sqrt(p["stiffness"] * p["load_inertia"])
    slowest = p["load_inertia"] * (2 * math.pi * SLOWEST) ** 2
    return p["damping"] < OVERDAMPED * critical and p["stiffness"] > slowest


# An arm's links have another inertia in each pose. The motor has the same: what ``load_inertia``
# leaves of this and of the rotor's. (With the mean along each recording in its place, the motor had
# another one in each: a known spring of a UR5 left 1 to 3 % of the torque unexplained.)
LINKS = Parameter(
    "links_inertia", "inertia", lower=0, default=0.0, fitted=False,
    meaning="of an arm's links, which load_inertia is a part of; 0: their mean in the recording",
)  # fmt: skip


def load_limits(facts: Facts) -> tuple[float, float]:
    """Limits of a load: a part of the whole inertia, which may itself be found up to three times as
    large; the kernel leaves the motor a fiftieth.
    """
    return 0.02 * facts.scale.inertia, 3.0 * facts.scale.inertia


def bristle_limits(facts: Facts) -> tuple[float, float]:
    """Limits of a bristle's stiffness, from a spring as soft as the motion is wide to almost rigid.
    """
    return (
        0.05 * facts.scale.torque / facts.scale.position,
        1e5 * facts.scale.torque / facts.scale.position,
    )


def off_centre(_facts: Facts) -> tuple[float, float]:
    """Limits of an eccentricity error: at most 3.4 degrees, as no encoder disc has more."""
    return 0.0, OFF_CENTRE


def even(p: Numbers) -> bool:
    """Whether a sensor's scale varies along its turn by no more than that of a disc off centre."""
    return p["order"] * p["amplitude"] <= OFF_CENTRE


def late(along: Along, p: Numbers) -> Array:
    """The torque that a delay removes from the command, to first order, N m or N; ``p`` has the
    time only.
    """
    (time,) = p.values()
    return np.diff(along.torque, prepend=along.torque[0]) * (time / along.sample_time)
