"""One run of the proof on sealed cases: diagnose, let the peers try, open, count."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from zendsp.proof.answer import Answer
from zendsp.proof.judge import Judgement, judge
from zendsp.proof.page import proof_page
from zendsp.proof.peers import METHODS, ask_peer, available, sysidentpy_trouble
from zendsp.proof.programme import Prepared
from zendsp.proof.score import answers, diagnose, identity, write_results
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
    made: Prepared,
    *,
    jobs: int,
    limit: float,
    with_peers: bool,
    command: str,
    tell: Tell,
    scheduler: str = "",
) -> Outcome:
    """Judge the cases of a folder; an interrupted run goes on where it stopped.

    Parameters
    ----------
    made : Prepared
        Cases and sealed truths.
    jobs : int
        Diagnoses at a time on this machine.
    limit : float
        Of a diagnosis, s.
    with_peers : bool
        Let the peers try the same cases.
    command : str
        For the page.
    tell : callable
        Receives a sentence after each case.
    scheduler : str
        Address of a Dask scheduler, whose workers diagnose; they see `made` under the same path.

    Raises
    ------
    BrokenSeal
        A truth was altered between sealing and opening.
    """
    folder = made.folder.resolve()
    folders = sorted(made.cases.resolve().iterdir())
    tell(f"{len(folders)} cases; truth sealed: {made.stamp}")
    given: dict[str, Answer] = {}
    ask = partial(diagnose, hidden=made.truth.resolve())
    asked = answers(
        folders, folder / "zendsp.json", jobs, limit, ask, code=identity(), scheduler=scheduler
    )
    for name, answer in asked:
        given[name] = answer
        tell(
            f"[{len(given)}/{len(folders)}] {name} {answer.seconds:.1f} s"
            f" {answer.trouble or answer.verdict}"
        )
    tried: dict[str, dict[str, Answer]] = {}
    troubles = available() if with_peers else {}
    for method in METHODS:
        if method in troubles and not troubles[method]:
            code = identity("proof/peers.py", "proof/tables.py", "proof/answer.py")
            tried[method] = dict(
                answers(folders, folder / f"{method}.json", 1, limit, asking(method), code)
            )
            tell(f"{method}: {len(tried[method])} cases")
    opened = open_truth(made.truth, made.stamp)
    tell("truth opened: the seals hold")
    judged = [judge(opened[name], given[name]) for name in sorted(opened)]
    peers = {
        m: [judge(opened[name], table[name]) for name in sorted(opened)]
        for m, table in tried.items()
    }
    write_results(folder / "results.json", judged, made.stamp)
    notes = [f"{m}: {words}" for m, words in troubles.items() if words]
    if with_peers and (words := sysidentpy_trouble()):
        notes.append(
            f"SysIdentPy's own FROLS does not run with the installed NumPy ({words}); FROLS is"
            " ours, by the textbook."
        )
    if peers:
        notes.append("The peers know one-joint and planar mechanisms; on arms they give no answer.")
    page = folder / "proof.md"
    page.write_text(
        proof_page(judged, peers, command=command, stamp=made.stamp, notes=notes), encoding="utf-8"
    )
    return Outcome(judged, peers, made.stamp, page)
