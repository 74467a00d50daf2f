"""The numbers of the story: what the loop hides, how the tracking error fell, and whether the truth
was found.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from zendsp.diagnosis import Diagnosis, Finding
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.link.concealed import TrueEffect, TrueValue
from zendsp.physics.effects import get_effect, library
from zendsp.physics.model import Model
from zendsp.physics.term_numbers import summed
from zendsp.recording import Recording
from zendsp.reference import Machine

Array = npt.NDArray[np.float64]

BOUNDARY_S = 0.5  # after the update, not counted: the filter and the loop settle
HIDDEN = 0.02  # of its travel: a joint that differs by less agrees with its simulation
SURE = 0.9  # confidence at which a wrong claim is no longer a doubt
PART = 0.05  # of the mismatch: what a wrong claim may explain at most
LEAST_FALL = 0.9  # of the error before: what counts as fallen
MOVED = 0.05  # of a number: a change from which it is another one
FOREIGN = "foreign"  # a concealed torque without a law in the library
CLOSE = 0.1  # of the size of an effect: what counts as the same size


def rms(values: Array) -> Array:
    """Root mean square of each column.

    Examples
    --------
    >>> import numpy as np
    >>> rms(np.array([[3.0], [-3.0]])).tolist()
    [3.0]
    """
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def columns(recording: Recording, name: str) -> Array:
    """A channel as (rows, joints)."""
    values = recording[name]
    return values if values.ndim == 2 else values[:, None]


@dataclass(frozen=True)
class Hidden:
    """The difference between simulation and recording for each joint, in position (rad) and command
    (N m), and the size of both.
    """

    position: tuple[float, ...]
    travel: tuple[float, ...]
    command: tuple[float, ...]
    effort: tuple[float, ...]

    def hides(self, joint: int) -> bool:
        """Whether a joint (1-based) agrees with its simulation in position."""
        return self.position[joint - 1] < HIDDEN * self.travel[joint - 1]

    @property
    def joint(self) -> int:
        """The joint (1-based) whose command differs most, relative to its effort."""
        return int(np.argmax(np.array(self.command) / np.array(self.effort))) + 1


def compare_loop(recording: Recording, simulated: Recording) -> Hidden:
    """The difference between a recording and the simulation of the same closed loop by the nominal
    model.

    Parameters
    ----------
    recording, simulated : Recording
        With q and tau, from the same first sample.
    """
    rows = min(len(recording), len(simulated))
    q, tau = columns(recording, "q")[:rows], columns(recording, "tau")[:rows]
    dq, dtau = q - columns(simulated, "q")[:rows], tau - columns(simulated, "tau")[:rows]
    return Hidden(
        tuple(rms(dq).tolist()),
        tuple(np.ptp(q, axis=0).tolist()),
        tuple(rms(dtau).tolist()),
        tuple(rms(tau).tolist()),
    )


@dataclass(frozen=True)
class Tracking:
    """RMS tracking error of each joint before and after the update, rad, and the sample of the
    update; measured while the machine works.
    """

    tick: int
    before: tuple[float, ...]
    after: tuple[float, ...]
    first_s: float  # between which it works
    last_s: float

    def fell(self, joints: Sequence[int]) -> bool:
        """Whether the error of every one of these joints (1-based) fell."""
        return all(self.after[j - 1] < LEAST_FALL * self.before[j - 1] for j in joints)


def compare_tracking(recording: Recording, tick: int, first_s: float, last_s: float) -> Tracking:
    """Compare the tracking error before and after a synchronous update.

    Parameters
    ----------
    recording : Recording
        With e; the update happened in it.
    tick : int
        Sample at which the update took effect.
    first_s, last_s : float
        Between which the machine works, s.
    """
    at = (tick - recording.start_tick) * recording.sample_time
    t = np.arange(len(recording)) * recording.sample_time
    e = columns(recording, "e")
    before = e[(t >= first_s) & (t < at)]
    after = e[(t >= at + BOUNDARY_S) & (t < last_s)]
    return Tracking(tick, tuple(rms(before).tolist()), tuple(rms(after).tolist()), first_s, last_s)


def matches(finding: Finding, truth: TrueEffect) -> bool:
    """Whether a finding is a concealed effect, or one of the effects that the recordings cannot
    tell from it is; of a torque without a law, that none is claimed at its joint.
    """
    if truth["effect"] == FOREIGN:
        return finding.effect == "unknown" and finding.joint == truth["joint"]
    if of_body(finding) and truth["effect"] in finding.indistinguishable:
        return True  # the same on the next link
    return finding.joint == truth["joint"] and truth["effect"] in (
        finding.effect, *finding.indistinguishable,
    )


def in_model_frame(effect: TrueEffect, plan: Machine) -> TrueEffect:
    """A concealed payload with its position in the frame of the model's link; the machine states it
    after the link's own twist (distal Denavit-Hartenberg). Other effects are unchanged.
    """
    if effect["effect"] != "payload" or plan.kind != "dh":
        return effect
    told = effect["parameters"]
    link = plan.parameters["link"][effect["joint"] - 1]
    twist = np.radians(link["alpha_deg"])
    x, y, z = (float(told[key]["value"]) for key in ("x", "y", "z"))
    place = (
        link["a"] + x,
        np.cos(twist) * y - np.sin(twist) * z,
        link["d"] + np.sin(twist) * y + np.cos(twist) * z,
    )
    com: dict[str, TrueValue] = {
        f"com_{k}": {"value": float(v), "unit": "m"} for k, v in zip("xyz", place, strict=True)
    }
    return {**effect, "parameters": {"mass": told["mass"], **com}}


def of_body(finding: Finding) -> bool:
    """Whether a finding is a body or the direction of gravity, which all joints feel."""
    effect = library().get(finding.effect)  # a disturbance has no law
    return effect is not None and effect.site == "body"


def matters(finding: Finding) -> bool:
    """Whether a false finding counts against the story: it was stated with confidence, or explains
    a considerable part.
    """
    return finding.confidence >= SURE or finding.share >= PART


@dataclass(frozen=True)
class Refit:
    """A number of the given model that calibration changed, because the machine has another."""

    effect: str
    joint: int  # 1-based
    name: str
    unit: str
    had: float
    value: float
    std: float

    @property
    def change(self) -> float:
        """The change as a fraction of the larger of both values."""
        larger = max(abs(self.value), abs(self.had))
        return abs(self.value - self.had) / larger if larger else 0.0

    @property
    def moved(self) -> bool:
        """Whether the number differs from the given one."""
        return self.change > MOVED and abs(self.value - self.had) > 3.0 * self.std

    def holds(self, truth: TrueEffect) -> bool:
        """Whether the change took up a concealed effect completely."""
        if (self.effect, self.joint) != (truth["effect"], truth["joint"]):
            return False
        sizes = truth["parameters"]
        size = float(sizes[self.name]["value"])
        return abs(self.value - self.had - size) <= max(CLOSE * abs(size), 3.0 * self.std)


def refits(diagnosis: Diagnosis) -> tuple[Refit, ...]:
    """The given model's own numbers beside their calibrated values: the size of each term, and the
    inertia of a single joint.
    """
    given, calibrated = diagnosis.given, diagnosis.calibrated
    out = []
    for before in given.terms:
        after = next((t for t in calibrated.at(before.joint) if t.effect == before.effect), None)
        if after is None:  # replaced
            continue
        name = get_effect(before.effect).linear[0]
        had, has = before.parameters[name], after.parameters[name]
        out.append(
            Refit(before.effect, before.joint, name, had.unit, had.value, has.value, has.std)
        )
    if given.kind == "rotary":
        had, has = given.mechanism["inertia"][0], calibrated.mechanism["inertia"][0]
        out.append(Refit("inertia", 1, "amount", "kg m^2", had.value, has.value, has.std))
    return tuple(out)


@dataclass(frozen=True)
class Judged:
    """The answer beside the truth.

    Attributes
    ----------
    named : bool
        Every concealed effect is among the findings, or among what a finding says it cannot be told
        from, or the calibration of what the given model has itself took it up.
    exact : bool
        And by its own name.
    by_calibration : tuple of Refit
        That took up a concealed effect.
    extra : tuple of Finding
        That are no concealed effect.
    parameters : tuple
        (name, found, std, true, unit, had) of those named exactly; where the effect adds to a term
        of the given model, the sums, and what that term had before.
    """

    named: bool
    exact: bool
    by_calibration: tuple[Refit, ...]
    extra: tuple[Finding, ...]
    parameters: tuple[tuple[str, float, float, float, str, float], ...]


def judge(diagnosis: Diagnosis, effects: Sequence[TrueEffect]) -> Judged:
    """The answer of a diagnosis, compared with what the machine revealed.

    Parameters
    ----------
    effects : sequence of mapping
        Of :class:`zendsp.link.concealed.Truth`.
    """
    found = diagnosis.findings
    fitted = refits(diagnosis)
    taken = [
        None
        if any(matches(f, truth) for f in found)
        else next((r for r in fitted if r.holds(truth)), None)
        for truth in effects
    ]
    lawless = diagnosis.verdict == Verdict.UNEXPLAINED
    named = all(
        took is not None
        or any(matches(f, truth) for f in found)
        or (lawless and truth["effect"] == FOREIGN)
        for truth, took in zip(effects, taken, strict=True)
    )
    pairs = [
        (f, truth)
        for truth in effects
        for f in found
        if f.effect == truth["effect"] and f.joint == truth["joint"]
    ]
    extra = tuple(f for f in found if not any(matches(f, truth) for truth in effects))
    rows = []
    for finding, truth in pairs:
        had, has = (_added(model, finding) for model in (diagnosis.given, diagnosis.improved))
        for name, told in truth["parameters"].items():
            estimate = finding.parameters.get(name)
            if estimate is not None and isinstance(told["value"], int | float):
                rows.append(
                    (
                        name, estimate.value + has, estimate.std, float(told["value"]) + had,
                        estimate.unit, had,
                    )
                )
    by_calibration = tuple(took for took in taken if took is not None)
    for truth, took in zip(effects, taken, strict=True):
        if took is not None:
            true = float(truth["parameters"][took.name]["value"]) + took.had
            rows.append((took.name, took.value, took.std, true, took.unit, took.had))
    exact = named and len(pairs) + len(by_calibration) == len(effects)
    return Judged(
        named and bool(found or by_calibration or lawless or not effects),
        exact,
        by_calibration,
        extra,
        tuple(rows),
    )


def _added(model: Model, finding: Finding) -> float:
    """The number of a model's own term to which a finding adds."""
    effect = library().get(finding.effect)
    symmetric = effect.symmetric if effect is not None else ""
    return summed(model, finding.joint, symmetric) if symmetric else 0.0
