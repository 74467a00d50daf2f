"""One run of the proof: make and seal, diagnose, let the peers try, open, count."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from zendsp.proof.answer import Answer
from zendsp.proof.judge import Judgement, judge
from zendsp.proof.page import proof_page
from zendsp.proof.peers import METHODS, ask_peer, available, sysidentpy_trouble
from zendsp.proof.programme import prepare
from zendsp.proof.score import answers, identity, write_results
from zendsp.proof.seal import open_truth

Tell = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """What a run of the proof gives."""

    judged: list[Judgement]
    peers: dict[str, list[Judgement]]
    stamp: str
    page: Path


def asking(method: str) -> Callable[[Path, Path, float], Answer]:
    """A peer in the form in which the scorer asks."""

    def ask(folder: Path, out: Path, limit: float) -> Answer:
        return ask_peer(method, folder)

    return ask


def run_proof(
    folder: Path,
    *,
    seed: int,
    quick: bool,
    jobs: int,
    limit: float,
    with_peers: bool,
    command: str,
    tell: Tell,
    sample: int = 0,
) -> Outcome:
    """Run the whole proof under `folder`; an interrupted run goes on where it stopped.

    With `sample`, only so many of the cases, drawn at random by the seed: all are made and sealed, the others are never asked.

    Raises
    ------
    BrokenSeal
        A truth was altered between sealing and opening.
    FileExistsError
        `folder` holds a run of other cases.
    """
    cases, truth, stamp = prepare(folder, seed, quick, jobs)
    folders = sorted(cases.iterdir())
    tell(f"{len(folders)} cases made; truth sealed: {stamp}")
    if sample:
        folders = sorted(random.Random(seed).sample(folders, min(sample, len(folders))))
    given: dict[str, Answer] = {}
    for name, answer in answers(folders, folder / "zendsp.json", jobs, limit, code=identity()):
        given[name] = answer
        tell(
            f"[{len(given)}/{len(folders)}] {name} {answer.seconds:.1f} s {answer.trouble or answer.verdict}"
        )
    tried: dict[str, dict[str, Answer]] = {}
    troubles = available() if with_peers else {}
    for method in METHODS:
        if method in troubles and not troubles[method]:
            tried[method] = dict(
                answers(
                    folders,
                    folder / f"{method}.json",
                    1,
                    limit,
                    asking(method),
                    identity("proof/peers.py", "proof/tables.py"),
                )
            )
            tell(f"{method}: {len(tried[method])} cases")
    opened = {name: entry for name, entry in open_truth(truth, stamp).items() if name in given}
    tell("truth opened: the seals hold")
    judged = [judge(opened[name], given[name]) for name in sorted(opened)]
    peers = {m: [judge(opened[name], table[name]) for name in sorted(opened)] for m, table in tried.items()}
    write_results(folder / "results.json", judged, stamp)
    notes = [f"{m}: {words}" for m, words in troubles.items() if words]
    if with_peers and (words := sysidentpy_trouble()):
        notes.append(
            f"SysIdentPy's own FROLS does not run with the installed NumPy ({words}); FROLS is ours, by the textbook."
        )
    if peers:
        notes.append("The peers know one-joint and planar mechanisms; on seven joints they give no answer.")
    page = folder / "proof.md"
    page.write_text(proof_page(judged, peers, command=command, stamp=stamp, notes=notes), encoding="utf-8")
    return Outcome(judged, peers, stamp, page)
