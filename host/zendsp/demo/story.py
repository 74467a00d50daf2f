"""The story: a machine conceals physics; it is recorded, diagnosed over the link, compensated while
it runs, and then reveals the truth.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from zendsp.demo.controller import BEARS, bearing, not_cancelled, plan_update
from zendsp.demo.evidence import (
    FOREIGN,
    Hidden,
    Judged,
    Refit,
    Tracking,
    compare_loop,
    compare_tracking,
    in_model_frame,
    judge,
    matters,
    of_body,
    refits,
)
from zendsp.demo.narrator import Narrator
from zendsp.demo.runs import Machine, prepare_machine
from zendsp.demo.stage import Stage
from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.decide.contract import Verdict
from zendsp.errors import Refused
from zendsp.link import Target
from zendsp.link.concealed import Truth
from zendsp.physics.files.model_write import model_text
from zendsp.physics.model import TREES
from zendsp.recording import Recording
from zendsp.reference import Reference
from zendsp_protocol.texts import counted
from zendsp_protocol.views import with_std

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Recorded:
    """What was known before the diagnosis."""

    seal: str
    train: Recording
    heldout: Recording
    simulated: Recording
    hidden: Hidden


@dataclass
class Told:
    """The results of the story, in their order."""

    recorded: Recorded
    diagnosis: Diagnosis
    separating: Recording | None = None
    work: Recording | None = None
    tracking: Tracking | None = None
    left_out: tuple[str, ...] = ()
    truth: Truth | None = None
    judged: Judged | None = None
    compensated: tuple[int, ...] = ()  # joints
    failures: list[str] = field(default_factory=list)

    @property
    def joint(self) -> int:
        """The joint (1-based) to show: where the effect was found, or, for a body, where the
        tracking error was largest.
        """
        found = self.diagnosis.findings
        if not found:
            return self.refits[0].joint if self.refits else self.recorded.hidden.joint
        if of_body(found[0]) and self.tracking is not None and self.compensated:
            before = self.tracking.before
            return max(self.compensated, key=lambda j: before[j - 1])
        return found[0].joint

    @property
    def found(self) -> str:
        """The findings in a line, each with what it cannot be told from."""
        findings = self.diagnosis.findings
        laws = [" or ".join((f.effect, *f.indistinguishable)).replace("_", " ") for f in findings]
        named = [f"{law} on joint {f.joint}" for law, f in zip(laws, findings, strict=True)]
        if not findings:
            named = [f"{r.effect} on joint {r.joint}, by calibration" for r in self.refits]
        return ", ".join(named) or "nothing"

    @property
    def refits(self) -> tuple[Refit, ...]:
        """Numbers of the given model that calibration had to change: where nothing else is missing,
        or where the finding is such a number.
        """
        moved = [refit for refit in refits(self.diagnosis) if refit.moved]
        if self.diagnosis.verdict != Verdict.COMPLETE:
            found = {(f.effect, f.joint) for f in self.diagnosis.findings}
            moved = [refit for refit in moved if (refit.effect, refit.joint) in found]
        return tuple(sorted(moved, key=lambda refit: refit.change, reverse=True))

    @property
    def calibrated(self) -> bool:
        """Whether numbers of the given model are all that was found."""
        return bool(self.refits) and len(self.refits) >= len(self.diagnosis.findings)

    @property
    def true(self) -> bool:
        """Whether the findings, the fit and the compensation are all right."""
        return not self.failures


def tell_story(target: Target, stage: Stage, out: Path, narrator: Narrator) -> Told:
    """Tell the whole story on a target that conceals something.

    Parameters
    ----------
    target : Target
        With the machine of the stage, and physics concealed that this process does not know.
    stage : Stage
    out : Path
        Receives recordings, the given model, the report, and story.png.
    narrator : Narrator

    Returns
    -------
    Told
    """
    machine, recorded = _record(target, stage, out, narrator)
    told = _diagnose(machine, recorded, out, narrator)
    _compensate(machine, told, out, narrator)
    _reveal(machine, told, narrator)
    return told


def _record(
    target: Target, stage: Stage, out: Path, narrator: Narrator
) -> tuple[Machine, Recorded]:
    narrator.chapter("1  A machine that conceals something")
    seal = target.seal()
    narrator.say(
        f"target {target.name} runs in process {target.info.pid}, {target.info.clock} clock; it"
        f" conceals physics under the seal {seal[:16]}…"
    )
    with narrator.step("compiling the control program on the target"):
        machine, seconds = prepare_machine(target, stage, out)
    (out / "given_model.toml").write_text(model_text(machine.model), encoding="utf-8")
    narrator.say(
        f"compiled track.c (model fed forward, PD feedback) on the target in {seconds:.2f} s"
    )
    plan = stage.plan
    with narrator.step("the machine moves and is recorded"):
        motion = stage.train(plan)
        train = machine.run(motion, "to be diagnosed")
        heldout = machine.run(stage.heldout(plan), "held out")
    train.save(out / "train.mat")
    heldout.save(out / "heldout.mat")
    narrator.say(
        f"recorded {len(train)} samples, a motion of {motion.duration:.1f} s and the rest after it;"
        f" and {len(heldout)} of another, held out; {train.lost + heldout.lost} lost"
    )
    with narrator.step("simulating the same run with the nominal model"):
        simulated = machine.simulate(motion)
    hidden = compare_loop(train, simulated)
    j, near = hidden.joint - 1, hidden.hides(hidden.joint)
    narrator.chapter(f"2  The loop {'hides' if near else 'cannot hide'} it")
    narrator.say(
        f"in position, simulation and machine {'agree' if near else 'part'}: joint {hidden.joint}"
        f" differs by {1e3 * hidden.position[j]:.3g} mrad RMS,"
        f" {100 * hidden.position[j] / hidden.travel[j]:.2g} % of its travel"
    )
    narrator.say(
        f"in the command {'they do not' if near else 'too'}: {hidden.command[j]:.2g} N m RMS,"
        f" {100 * hidden.command[j] / hidden.effort[j]:.0f} % of the effort: the controller fights"
        " something that the model lacks"
    )
    return machine, Recorded(seal, train, heldout, simulated, hidden)


def _diagnose(machine: Machine, recorded: Recorded, out: Path, narrator: Narrator) -> Told:
    narrator.chapter("3  The diagnosis")

    def look(recordings: list[Recording]) -> Diagnosis:
        with narrator.step("diagnosing"):
            return diagnose(
                recordings, out / "given_model.toml", recorded.heldout, jobs=os.cpu_count() or 1,
                progress=narrator.progress,
            )

    told = Told(recorded, look([recorded.train]))
    _say_findings(told.diagnosis, narrator)
    # a body of the next link that predicts the same is taken up by the same torque
    if any(f.indistinguishable and not of_body(f) for f in told.diagnosis.findings):
        told.separating = _separate(machine, told.diagnosis, narrator)
        if told.separating is not None:
            told.separating.save(out / "separating.mat")
            told.diagnosis = look([recorded.train, told.separating])
            narrator.say("with the second recording:")
            _say_findings(told.diagnosis, narrator)
    for refit in told.refits if not told.diagnosis.findings else ():
        narrator.say(
            f"what: the model has every law, but not the number: {refit.effect} of joint"
            f" {refit.joint}, {refit.name} {refit.had:.4g} given,"
            f" {with_std(refit.value, refit.std, refit.unit)} refitted"
        )
    held = told.diagnosis.heldout
    # numbers of a model without links take a body up: calibration alone is as good
    carried = told.diagnosis.given.kind not in TREES and any(map(of_body, told.diagnosis.findings))
    if told.calibrated or carried:
        better = max(held.calibrated, held.improved) < held.given
    else:
        better = held.improved < held.calibrated
    # a torque without a law may be beyond what a model file can say
    lawful = bool(told.refits) or any(f.effect != "unknown" for f in told.diagnosis.findings)
    bent = " (bent by what it lacks)" if held.calibrated > held.given else ""
    narrator.say(
        f"on the held-out recording the error of free simulation is {1e3 * held.given:.3g} mrad"
        f" given, {1e3 * held.calibrated:.3g} calibrated{bent}, {1e3 * held.improved:.3g}"
        f" improved (noise floor {1e3 * told.diagnosis.noise_floor:.2g})",
        good=better if lawful or better else None,
    )
    if lawful and not better:
        told.failures.append("the fitted model is not better on the held-out recording")
    return told


def _say_findings(d: Diagnosis, narrator: Narrator) -> None:
    narrator.say(f"verdict: {d.verdict} ({d.seconds:.1f} s)")
    told_of = d.findings[0].joint if d.findings else 0
    for region in [r for r in d.regions if told_of in (0, r.joint)][:1]:
        narrator.say(
            f"where: joint {region.joint}, {region}: {100 * region.share:.0f} % of the mismatch"
            f" in {100 * region.time_share:.0f} % of the time"
        )
    for f in d.findings:
        narrator.say(f"what: {f.sentence} (confidence {100 * f.confidence:.0f} %)")
    if d.unexplained:
        narrator.say(d.unexplained)


def _separate(machine: Machine, d: Diagnosis, narrator: Narrator) -> Recording | None:
    """Run the experiment that the diagnosis proposes, where the machine may play it."""
    proposal = d.next_recording
    if proposal is None:
        return None
    narrator.say(proposal.sentence)
    if proposal.reference is None:
        return None
    motion = _within_limits(machine, *proposal.reference, narrator)
    if motion is None:
        return None
    with narrator.step("running the separating experiment on the target"):
        try:
            return machine.run(motion, "separates rivals")
        except Refused as refused:
            narrator.say(str(refused), good=False)
            return None


def _within_limits(
    machine: Machine, q: Array, period: float, narrator: Narrator
) -> Reference | None:
    """A proposed motion, scaled about its middle to the machine's limits; None where less than two
    fifths of it would remain.
    """
    middle = q.mean(axis=0)
    for part in (1.0, 0.8, 0.6, 0.4):
        made = middle + part * (q - middle)
        motion = Reference(made, period, kind="separating", machine=machine.stage.machine)
        broken = machine.stage.plan.find_violations(motion)
        if not broken:
            if part < 1.0:
                narrator.say(f"the machine may play {100 * part:.0f} % of its size")
            return motion
    narrator.say(f"the machine may not play it: {broken[0]}")
    return None


def _compensate(machine: Machine, told: Told, out: Path, narrator: Narrator) -> None:
    d = told.diagnosis
    if not d.findings and not told.refits:
        return
    narrator.chapter("4  Into the running program")
    update = plan_update(d.given, d.improved, machine.target.variables())
    motion = machine.stage.work(machine.stage.plan)
    borne = bearing(d.given, d.improved, motion, machine.stage.Kp)
    told.left_out = not_cancelled(update, d.findings)
    told.compensated = tuple(sorted({*update.joints, *borne, *(r.joint for r in told.refits)}))
    for sentence in told.left_out:
        narrator.say(f"not compensated: {sentence}")
    begin = machine.stage.approach_s
    half, end = begin + 0.5 * motion.duration, begin + motion.duration
    with narrator.step("the machine works; half-way the found physics is switched on"):
        try:
            told.work = machine.run(
                motion, "compensation switched on half-way", (half, update.values)
            )
        except Refused as refused:
            told.failures.append(str(refused))
            narrator.say(str(refused), good=False)
            return
    told.work.save(out / "work.mat")
    tick = max(change.tick for change in told.work.log)
    told.tracking = compare_tracking(told.work, tick, begin + 1.0, end - 0.5)
    narrator.say(
        f"one synchronous update of {counted(len(update.values), 'parameter')} at sample {tick},"
        " while the"
        " machine moved"
    )
    if borne:  # dry friction holds a joint that is pulled little, and its error with it
        least = BEARS * max(told.tracking.before[j - 1] for j in borne)
        told.compensated = tuple(
            j for j in told.compensated if told.tracking.before[j - 1] >= least
        )
    joints = told.compensated or tuple(sorted({f.joint for f in d.findings}))
    for j in joints:
        before, after = told.tracking.before[j - 1], told.tracking.after[j - 1]
        narrator.say(
            f"tracking error of joint {j}: {1e3 * before:.3g} mrad before, {1e3 * after:.3g} after",
            good=told.tracking.fell([j]) if told.compensated else None,
        )
    if told.compensated and not told.tracking.fell(told.compensated):
        told.failures.append("the tracking error did not fall")


def _short(value: float | str) -> str:
    return value if isinstance(value, str) else f"{value:.4g}"


def compared(name: str, value: float, std: float, true: float, unit: str, had: float) -> str:
    """A sentence with a number beside the truth; of a sum, with its concealed part."""
    of = "" if unit == "1" else f" {unit}"
    parts = f": the concealed {true - had:.4g} and the given model's {had:.4g}" if had else ""
    return f"{name}: found {with_std(value, std)}, true {true:.4g}{of}{parts}"


def _reveal(machine: Machine, told: Told, narrator: Narrator) -> None:
    narrator.chapter("5  The truth")
    truth = machine.target.reveal()
    told.truth = truth
    if truth.sha256 != told.recorded.seal:
        told.failures.append("the revealed record is not the one sealed at the beginning")
    concealed = [in_model_frame(effect, machine.stage.plan) for effect in truth.effects]
    for effect, told_of in zip(concealed, truth.effects, strict=True):
        values = ", ".join(
            f"{name} {_short(p['value'])} {p['unit']}".rstrip()
            for name, p in effect["parameters"].items()
        )
        frame = "" if effect is told_of else f" in the model's frame of link {effect['joint']}"
        narrator.say(
            f"concealed: {effect['effect']} on joint {effect['joint']}: {values}{frame}"
            f" ({truth.source})"
        )
    judged = told.judged = judge(told.diagnosis, concealed)
    if judged.exact and judged.by_calibration:
        narrator.say("found by calibration: only the number of a law was wrong", good=True)
    elif judged.exact:
        narrator.say("named right", good=True)
    elif judged.named and any(effect["effect"] == FOREIGN for effect in concealed):
        narrator.say("it has no law here, and none was claimed for it", good=True)
    elif judged.named:
        narrator.say("among those that the recordings cannot tell apart", good=True)
    else:
        narrator.say(f"not found: the diagnosis named {told.found}", good=False)
        verdict = told.diagnosis.verdict
        told.failures.append(f"the concealed effect was not named: the verdict is {verdict}")
    for row in judged.parameters:
        narrator.say(compared(*row))
    _named_beside(machine.stage, judged, told, narrator)


def _named_beside(stage: Stage, judged: Judged, told: Told, narrator: Narrator) -> None:
    """Tell of what was named beside the concealed effects, and whether the machine has it."""
    for extra in judged.extra:
        name = f"{extra.effect} on joint {extra.joint}"
        if why := stage.besides.get(extra.effect):
            narrator.say(f"named beside it, and true of this machine: {name}; {why}", good=True)
            continue
        narrator.say(
            f"named beside it, and not there: {name}, {100 * extra.share:.1f} % of the mismatch",
            good=False,
        )
        if judged.named and matters(extra):
            told.failures.append(f"{name} was named and is not there")
