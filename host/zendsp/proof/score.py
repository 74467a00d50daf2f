"""``python -m zendsp.proof.score CASES TRUTH``: runs the command on every case and prints the
scoreboard.

The diagnosis is a separate process that sees the recordings and the model, never the truth; a run
that was interrupted goes on where it stopped (``--out`` keeps one line per finished case beside
it).
"""

from __future__ import annotations

import hashlib
import json
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import click

from zendsp.proof import children
from zendsp.proof.answer import Answer, ContractError, read_report
from zendsp.proof.judge import Judgement, judge
from zendsp.proof.scoreboard import failures, headline, text
from zendsp.proof.seal import BrokenSeal, open_truth

# packages below zendsp/ whose code gives the answers
JUDGED = (
    "diagnosis", "physics", "recording", "reference", "cli/diagnose.py", "proof/answer.py",
    "proof/untouched.py",
)


def diagnose(
    folder: Path,
    out: Path,
    limit: float,
    *,
    hidden: Path | None = None,
    command: Sequence[str] = (),
) -> Answer:
    """Run the command on one case within `limit` seconds; never raises for what the command does.

    Parameters
    ----------
    folder : path
        Of the case.
    out : path
        Of the report.
    limit : float
        s.
    hidden : path, optional
        Folder of the truths: the untouched recording that lies there is tried after the diagnosis.
    command : sequence of str
        In place of ``zendsp diagnose``.
    """
    listing = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    model = folder / listing["model"]
    line = [
        *(command or children.command("diagnose")),
        *(str(folder / name) for name in listing["train"]),
    ]
    line += ["--model", str(model)]
    for name in listing["heldout"]:
        line += ["--heldout", str(folder / name)]
    answer = asked([*line, "--json", "--jobs", "1", "--no-figures"], out, limit)
    untouched = hidden / f"{folder.name}_untouched.npz" if hidden is not None else None
    if answer.findings and untouched is not None and untouched.exists():
        answer = replace(answer, untouched=tried(untouched, model, out, limit))
    return answer


def asked(line: Sequence[str], out: Path, limit: float) -> Answer:
    """The answer of a command that writes its report under `out`."""
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.json").unlink(missing_ok=True)
    ended = children.run([*line, "--out", str(out)], out, limit)
    if ended.status is None:
        return Answer("", trouble=f"no answer within {limit:g} s", seconds=limit, cpu=ended.cpu)
    if ended.status != 0:
        words = f"exit status {ended.status}: {ended.last_words[:160]}"
        return Answer("", trouble=words, seconds=ended.seconds, cpu=ended.cpu)
    try:
        return replace(read_report(out / "report.json", ended.seconds), cpu=ended.cpu)
    except (ContractError, KeyError, TypeError, ValueError) as error:
        return Answer("", trouble=f"broken report: {error}", seconds=ended.seconds, cpu=ended.cpu)


def tried(recording: Path, model: Path, out: Path, limit: float) -> tuple[float, float]:
    """Error of the calibrated and of the improved model on a recording that the diagnosis never
    saw; NaN where unknown.
    """
    words = (str(recording), str(model), str(out / "calibrated.toml"), str(out / "model.toml"))
    spot = out / "untouched"
    ended = children.run(children.module("zendsp.proof.untouched", *words), spot, limit)
    if ended.status != 0:
        return math.nan, math.nan
    calibrated, improved = json.loads((spot / "stdout.txt").read_text(encoding="utf-8"))
    return float(calibrated), float(improved)


def identity(*packages: str) -> str:
    """Hash of the code that answers: an answer of other code is not taken for one of this.

    Only bytes are read; nothing of the judged code is imported.
    """
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for package in packages or JUDGED:
        base = root / package
        for path in sorted(base.rglob("*")) if base.is_dir() else [base]:
            if path.suffix in (".py", ".c", ".h"):
                digest.update(
                    path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes()
                )
    return digest.hexdigest()[:16]


def known_answers(path: Path, code: str = "") -> dict[str, Answer]:
    """Answers of an interrupted run, one JSON line each; a line cut short, or of other code, is
    left out.
    """
    out: dict[str, Answer] = {}
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            entry = json.loads(line)
        except json.JSONDecodeError:
            continue
        if entry.get("code", "") != code:
            continue
        out[entry["case"]] = Answer.from_json(entry["answer"])
    return out


def answers(
    folders: Sequence[Path],
    out: Path,
    jobs: int,
    limit: float,
    ask: Callable[[Path, Path, float], Answer] = diagnose,
    code: str = "",
    scheduler: str = "",
) -> Iterator[tuple[str, Answer]]:
    """Yield (case, answer) as they come, those of an earlier run first; each new one is kept on
    disk at once.

    `jobs` at a time on this machine, or as the Dask cluster of `scheduler` has workers.
    """
    log = out.with_suffix(".jsonl")
    log.parent.mkdir(parents=True, exist_ok=True)
    known = known_answers(log, code)
    yield from ((f.name, known[f.name]) for f in folders if f.name in known)
    todo = [f for f in folders if f.name not in known]
    reports = out.parent / f"{out.stem}_reports"
    workers = children.cluster(scheduler) if scheduler else children.threads(jobs)
    with children.workers(workers) as pool:
        running = {pool.submit(ask, f, reports / f.name, limit): f.name for f in todo}
        for future in as_completed(running):
            name, answer = running[future], future.result()
            with log.open("a", encoding="utf-8") as file:
                file.write(
                    json.dumps({"case": name, "code": code, "answer": answer.to_json()}) + "\n"
                )
            yield name, answer


def write_results(path: Path, judged: Sequence[Judgement], stamp: str) -> None:
    """The judgements and the headline as JSON."""
    table = {
        "seals": stamp,
        "headline": [
            {"what": w.strip(), "measured": m, "wanted": x} for w, m, x in headline(judged)
        ],
        "cases": [asdict(j) for j in judged],
    }
    path.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("cases", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("truth", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--jobs", type=int, default=2, show_default=True)
@click.option(
    "--only", default="",
    help="Words; only cases whose truth has one as kind, machine, effect or name.",
)
@click.option("--limit", type=float, default=120.0, show_default=True, help="Seconds per case.")
@click.option("--fresh", is_flag=True, help="Forget the answers of an earlier run.")
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("results.json"), show_default=True
)
def main(
    cases: Path, truth: Path, jobs: int, only: str, limit: float, fresh: bool, out: Path
) -> None:
    """Diagnose every case under CASES and compare with the sealed TRUTH."""
    try:
        truths = open_truth(truth)
    except BrokenSeal as error:
        raise click.ClickException(str(error)) from error
    wanted = set(only.replace(",", " ").split())
    chosen = [
        name
        for name, t in sorted(truths.items())
        if not wanted
        or wanted & {t["kind"], t["machine"], name, *(e["effect"] for e in t["effects"])}
    ]
    if fresh:
        out.with_suffix(".jsonl").unlink(missing_ok=True)
    judged: list[Judgement] = []
    folders = [cases / name for name in chosen]
    ask = partial(diagnose, hidden=truth)
    for count, (name, answer) in enumerate(answers(folders, out, jobs, limit, ask, identity()), 1):
        j = judge(truths[name], answer)
        judged.append(j)
        mark = "FAIL" if failures([j]) else "ok"
        print(
            f"[{count}/{len(chosen)}] {name} {answer.seconds:5.1f} s {mark:4} {j.said[:110]}",
            file=sys.stderr,
        )
    judged.sort(key=lambda j: j.case)
    write_results(out, judged, str(truth))
    print(text(judged, str(cases)))


if __name__ == "__main__":
    main()
