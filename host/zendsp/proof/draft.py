"""One case while it is being made: the true machine, the model that will be given, and what is
concealed.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from zendsp.proof.reality import CouplingTruth, JointTruth, LinkTruth, MachineTruth
from zendsp.proof.truth import Place

Array = npt.NDArray[np.float64]


@dataclass
class Term:
    """One ``[[effect]]`` of the given model."""

    kind: str
    joint: int  # 1-based
    values: dict[str, float]
    free: bool = True
    extra: dict[str, str | int] = field(default_factory=dict)  # written as they are


@dataclass
class Concealed:
    """One effect of the truth that the given model lacks, in the words of the contract."""

    effect: str
    joint: int  # 1-based
    parameters: dict[str, tuple[float, str]]  # name -> (value, unit)
    size: float  # knob: 1, 0.3, 0.1
    # exact aliases: same equation of motion by algebra
    accepted: list[str] = field(default_factory=list)
    accepted_joints: list[int] = field(default_factory=list)
    # parameters that the given structure cannot separate
    unscored: list[str] = field(default_factory=list)
    note: str = ""
    where: list[Place] = field(default_factory=list)
    mechanisms: list[str] = field(default_factory=list)  # right besides the effect's own
    body: str = ""  # the link whose body it is


@dataclass
class Draft:
    """A case in the making; `joints` holds the changes of each joint's :class:`JointTruth`."""

    machine: str  # rotary | linear | pendulum | planar2r | urdf
    kind: str  # of [mechanism]
    parameters: dict[str, float]  # true figures of [mechanism.parameters]
    joints: list[dict[str, Any]]
    terms: list[set[str]]  # friction laws that the given model has, per joint
    sample_time: float
    seconds: float
    amplitude: list[float]  # of references, per joint
    speed: list[float]
    kp: list[float]
    kd: list[float]
    velocity_filter: float = 0.0
    known_delay: float = 0.0
    show_controller: bool = False
    feedforward: bool = False
    open_loop: bool = False
    fixed: set[str] = field(default_factory=set)  # mechanism parameters with free = false
    fixed_terms: bool = False
    absent: set[str] = field(
        default_factory=set
    )  # mechanism parameters that the given model puts at zero, fixed
    exact: bool = False  # given figures without errors
    couplings: list[CouplingTruth] = field(default_factory=list)
    links: tuple[LinkTruth, ...] = ()
    concealed: list[Concealed] = field(default_factory=list)
    known: list[Term] = field(
        default_factory=list
    )  # effects of the truth that the given model has as they are
    disturbance: list[tuple[int, Array]] = field(
        default_factory=list
    )  # (joint 0-based, torque over t / seconds)
    # terms of the given model that the truth does not have
    replaces: list[str] = field(default_factory=list)
    # | none: the last third is held out | joint: both recordings are for training
    layout: str = "heldout"
    nuisance: float = 0.0  # slow random torque, share of the torque's RMS
    # of the training run, by joint (0-based)
    nuisance_torque: dict[int, Array] = field(default_factory=dict)
    noise: float = 0.0  # share of the resolution
    train_shape: str = "multisine"
    heldout_shape: str = "sines"
    down: tuple[float, float, float] = (0.0, 0.0, -9.81)
    centre: list[float] = field(default_factory=lambda: [0.0] * 7)  # of the motion, per joint
    # torque per command unit that the model states
    stated_gain: list[float] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)  # of the logger: see zendsp.proof.measure
    also_true: set[str] = field(default_factory=set)  # names that may stand beside the truth
    notes: list[str] = field(default_factory=list)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)

    def truth(self) -> MachineTruth:
        """The machine to simulate."""
        joints = tuple(JointTruth(**changes) for changes in self.joints)
        fastest = max([0.0] + [j.trans_stiffness / max(j.motor_inertia, 1e-12) for j in joints])
        # ten steps a radian of the stiffest spring, and never coarser than 20 us (chains: 50 us,
        # they are smooth)
        step = min(
            5e-5 if self.kind == "urdf" else 2e-5, 0.1 / np.sqrt(fastest) if fastest else 1.0
        )
        return MachineTruth(
            self.kind,
            joints,
            tuple(self.parameters.values()),
            tuple(self.couplings),
            self.links,
            self.down,
            self.sample_time,
            max(10, int(np.ceil(self.sample_time / step))),
            tuple([0.0] * self.n if self.open_loop else self.kp),
            tuple([0.0] * self.n if self.open_loop else self.kd),
            ki=(0.0,) * self.n,
            velocity_filter=self.velocity_filter,
            q0=tuple([0.0] * self.n if self.open_loop else self.centre[: self.n]),
            v0=(0.0,) * self.n,
        )

    def mechanism_alone(self) -> MachineTruth:
        """The chain without anything that acts in its joints."""
        plain = tuple(JointTruth() for _ in self.joints)
        return MachineTruth(
            self.kind, plain, tuple(self.parameters.values()), links=self.links, down=self.down,
            kp=(0.0,) * self.n, kd=(0.0,) * self.n, ki=(0.0,) * self.n, q0=(0.0,) * self.n,
            v0=(0.0,) * self.n,
        )


@dataclass(frozen=True)
class Scale:
    """Sizes of one joint's motion without the concealed effect: what an effect's size is measured
    against.
    """

    torque: float  # RMS of the motor torque, N m
    peak: float  # of the torque
    command: Array  # (rows,)
    drive: Array  # motor torque, (rows,)
    q: Array
    v: Array
    a: Array
    slides: npt.NDArray[np.bool_]  # neither at rest nor turning within the hold interval

    @property
    def v_rms(self) -> float:
        """RMS speed, rad/s or m/s."""
        return float(np.sqrt(np.mean(self.v**2)))

    @property
    def v_peak(self) -> float:
        """Largest speed, rad/s or m/s."""
        return float(np.max(np.abs(self.v)))

    @property
    def reach(self) -> float:
        """Travel, rad or m."""
        return float(np.ptp(self.q))
