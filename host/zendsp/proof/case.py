"""A case, asked for and finished; what every reality makes."""

from __future__ import annotations

from dataclasses import dataclass, field

from zendsp.proof.model_table import ModelTable
from zendsp.proof.reality import Run
from zendsp.proof.truth import Truth


@dataclass(frozen=True)
class Request:
    """What case to make."""

    seed: int
    kind: str  # a key of conceal.KINDS
    machine: str = "rotary"
    effect: str = ""  # for the kinds that conceal one effect
    size: float = 1.0
    reality: str = "own"  # who simulates it: own | mujoco
    given: str = ""  # "mjcf": where the reality is MuJoCo's, an arm's model is given as its MJCF


@dataclass(frozen=True)
class Case:
    """A finished case: what the tool sees, and the truth."""

    train: Run
    heldout: Run
    model: ModelTable
    truth: Truth
    form: str
    layout: str  # of the files: see Draft.layout
    untouched: Run  # of the same machine; no diagnosis ever sees it
    # what the model names besides, by file name
    files: dict[str, str] = field(default_factory=dict)


class Unusable(RuntimeError):
    """This draw makes no sensible recording; draw again."""


class NoUsableCase(RuntimeError):
    """No draw of a request makes a sensible recording."""
