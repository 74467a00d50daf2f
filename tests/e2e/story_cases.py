"""Short live cases: a pendulum that conceals an effect by seed, recorded and diagnosed over the
link, the truth told afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import zendsp
from zendsp.demo.evidence import judge
from zendsp.demo.runs import prepare_machine
from zendsp.demo.stage import get_stage
from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.link.concealed import Truth
from zendsp.physics.files.model_write import model_text
from zendsp.reference import Reference

SECONDS = 5.0


@dataclass(frozen=True)
class Answer:
    """The outcome of one live case."""

    seed: int
    diagnosis: Diagnosis
    truth: Truth
    named: bool
    sealed_before: bool

    @property
    def confident(self) -> float:
        """Highest confidence of a finding."""
        return max((f.confidence for f in self.diagnosis.findings), default=0.0)

    def line(self) -> str:
        """For the message of a test that fails."""
        true = ", ".join(f"{e['effect']} on joint {e['joint']}" for e in self.truth.effects)
        found = (
            ", ".join(
                f"{f.effect} {f.indistinguishable or ''} ({f.confidence:.2f})"
                for f in self.diagnosis.findings
            )
            or self.diagnosis.verdict
        )
        return (
            f"seed {self.seed}: {'right' if self.named else 'WRONG'}: concealed {true}; said"
            f" {found}"
        )


def swings(rates: tuple[float, ...], phase: float) -> Reference:
    """Slow and fast swings of the pendulum with many reversals, 5 s, from rest to rest."""
    t = np.arange(round(SECONDS * 1000) + 1) * 1e-3
    rise = np.clip(np.minimum(t, SECONDS - t) / 0.5, 0.0, 1.0)
    shape = sum(
        a * np.sin(2 * np.pi * f * t + phase * k)
        for k, (f, a) in enumerate(zip(rates, (1.0, 0.45, 0.2), strict=True))
    )
    return Reference(
        2.2 * np.asarray(shape) * rise**2 * (3.0 - 2.0 * rise),
        1e-3,
        kind="swings",
        machine="pendulum",
    )


def live_case(seed: int, pool: str, folder: Path) -> Answer:
    """Start a target that conceals an effect, diagnose it over the link, then ask for the truth."""
    stage = get_stage("pendulum")
    with zendsp.local(
        "pendulum",
        clock="fast",
        options=["--concealed", f"seed:{seed},effect={pool},friction=plain"],
    ) as target:
        seal = target.seal()
        machine, _ = prepare_machine(target, stage)
        train = machine.run(swings((0.35, 0.9, 1.7), 1.0), "to be diagnosed")
        heldout = machine.run(swings((0.5, 1.1, 1.5), 2.0), "held out")
        diagnosis = diagnose(train, machine.model, heldout, jobs=1)
        truth = target.reveal()  # not before
    answer = Answer(
        seed, diagnosis, truth, judge(diagnosis, truth.effects).named, truth.sha256 == seal
    )
    if not answer.named:
        case = folder / str(seed)
        case.mkdir(parents=True, exist_ok=True)
        train.save(case / "train.mat")
        heldout.save(case / "heldout.mat")
        (case / "given_model.toml").write_text(model_text(machine.model), encoding="utf-8")
    return answer
