"""What is sealed of a case: what it conceals, and all that is right to answer."""

from __future__ import annotations

from typing import NotRequired, TypedDict


class Number(TypedDict):
    """A concealed parameter."""

    value: float
    unit: str


class Oracle(TypedDict, total=False):
    """How plainly an effect shows in the recording to somebody who knows the true motion."""

    torque_share: float  # what a refit leaves of its torque, over the RMS torque
    innovation_ratio: float
    log_likelihood: float
    detectable: bool
    inseparable: dict[str, float]  # effects that the recording cannot tell from it


class Effect(TypedDict):
    """One concealed effect."""

    effect: str
    joint: int  # 1-based
    parameters: dict[str, Number]
    size: float  # knob: 1, 0.3, 0.1
    accepted: list[str]  # exact aliases
    accepted_joints: list[int]
    mechanisms: NotRequired[list[str]]  # right besides the effect's own
    body: NotRequired[str]  # the link whose body it is
    unscored: list[str]  # parameters that the given structure cannot separate
    note: str
    oracle: NotRequired[Oracle]


class Place(TypedDict):
    """A place that a locator should show: an interval of time, or a value of a joint's variable."""

    variable: str
    joint: NotRequired[int]
    value: NotRequired[float]
    interval: NotRequired[list[float]]  # s


class Truth(TypedDict):
    """A case's truth; the last four are known once it is written."""

    kind: str  # a key of conceal.KINDS
    machine: str
    flavour: NotRequired[str]  # of the request's effect
    verdict: str  # complete | missing | unexplained
    size: float
    effects: list[Effect]
    also_true: list[str]  # names that may stand beside the truth
    replaces: list[str]  # terms of the given model that the truth does not have
    where: list[Place]
    train: str  # shape of the motion
    heldout: str
    seconds: float
    layout: str  # see Draft.layout
    notes: list[str]
    case: NotRequired[str]
    seed: NotRequired[int]
    untouched: NotRequired[str]  # SHA-256 of the recording that no diagnosis sees
    reality: NotRequired[str]
    given: NotRequired[str]  # form of the given model where it is not the usual one
