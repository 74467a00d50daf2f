"""The demo from nothing to a report: starts the target, tells the story, writes what was made, and
ends the target.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from zendsp.demo.narrator import Narrator
from zendsp.demo.stage import get_stage
from zendsp.demo.story import Told, tell_story
from zendsp.link import local


def concealment(pool: tuple[str, ...], effect: str | None, seed: int | None) -> str:
    """What the target is told to draw from. It draws in its own process, and without a seed nobody
    here can repeat the draw.

    Examples
    --------
    >>> concealment(("ripple", "gravity"), None, None)
    'seed:random,effect=ripple/gravity,friction=plain'
    """
    return f"seed:{'random' if seed is None else seed},effect={effect or '/'.join(pool)},friction=plain"  # noqa: E501


def run_demo(
    out: Path,
    *,
    machine: str = "imi_planar",
    effect: str | None = None,
    seed: int | None = None,
    clock: str = "fast",
    narrator: Narrator | None = None,
) -> Told:
    """Start a target that conceals an effect, find the effect, compensate for it, reveal it, and
    write the report and story.json.

    Parameters
    ----------
    out : Path
        Folder, made where it does not exist.
    machine : str
        "imi_planar", "pendulum" or "wam7".
    effect : str, optional
        The effect to conceal, or several with "/" to draw from. Default: the machine's pool.
    seed : int, optional
        Draws effect, joint and sizes. Default: the target draws one itself.
    clock : {"fast", "real"}
        Of the target.
    narrator : Narrator, optional
        Default: a quiet one.

    Returns
    -------
    Told
    """
    teller = narrator or Narrator(quiet=True)
    stage = get_stage(machine)
    out.mkdir(parents=True, exist_ok=True)
    with teller.step("starting the target"):
        target = local(
            machine, clock=clock, options=["--concealed", concealment(stage.pool, effect, seed)]
        )
    with target:
        told = tell_story(target, stage, out, teller)
    files = _write(told, out, teller)
    teller.say(
        f"the same again: zendsp demo --machine {machine}{f' --effect {effect}' if effect else ''}"
        f" --seed {_seed(told)}"
    )
    teller.say(f"{teller.seconds:.0f} s in all")
    outcome = _outcome(told, files, teller)
    (out / "story.json").write_text(
        json.dumps(outcome, indent=1, ensure_ascii=False, allow_nan=False), encoding="utf-8"
    )
    return told


def _write(told: Told, out: Path, teller: Narrator) -> list[Path]:
    from zendsp.demo.picture import draw
    from zendsp.diagnosis.report.files import write_report

    again = ", in place of an earlier one (--out has another folder)"
    earlier = again if (out / "report.html").is_file() else ""
    with teller.step("writing the report"):
        write_report(told.diagnosis, out)
        draw(told, out / "story.png")
    teller.chapter(
        "It is a true story" if told.true else "The story is not true: " + "; ".join(told.failures)
    )
    teller.say(f"report  {out / 'report.html'}{earlier}")
    teller.say(f"picture {out / 'story.png'}")
    return [
        out / name
        for name in (
            "report.html", "story.png", "train.mat", "heldout.mat", "given_model.toml",
            "model.toml",
        )
    ]


def _seed(told: Told) -> str:
    """The seed with which the target drew, which the truth contains."""
    return told.truth.source.removeprefix("seed:") if told.truth else "?"


def _outcome(told: Told, files: list[Path], teller: Narrator) -> dict[str, Any]:
    from zendsp.diagnosis.report.files import finite

    report = told.diagnosis.report()
    tracking = None
    if told.tracking is not None:
        tracking = {
            "tick": told.tracking.tick, "before_rad": list(told.tracking.before),
            "after_rad": list(told.tracking.after), "compensated_joints": list(told.compensated),
            "not_compensated": list(told.left_out),
        }
    outcome = {
        "true": told.true,
        "why": told.failures,
        "seal": told.recorded.seal,
        "truth": [dict(effect) for effect in told.truth.effects] if told.truth else [],
        "source": told.truth.source if told.truth else "",
        "verdict": report["verdict"],
        "findings": report["findings"],
        "refitted": [asdict(refit) for refit in told.refits],
        "fit": report["fit"],
        "hidden": {
            "position_rad": list(told.recorded.hidden.position),
            "command": list(told.recorded.hidden.command),
            "effort": list(told.recorded.hidden.effort),
        },
        "separated": told.separating is not None,
        "tracking": tracking,
        "files": [str(path) for path in files],
        "lost": told.recorded.train.lost + told.recorded.heldout.lost,
        "seconds": round(teller.seconds, 1),
        "said": teller.said,
    }
    return {key: finite(value) for key, value in outcome.items()}
