"""``python -m zendsp.proof.score CASES TRUTH``: runs the command on every case and prints the scoreboard.

The diagnosis is a separate process that sees the recordings and the model, never the truth; a run that was interrupted
goes on where it stopped (``--out`` keeps one line per finished case beside it).
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path

import click

from zendsp.proof.answer import Answer, ContractError, read_report
from zendsp.proof.judge import Judgement, judge
from zendsp.proof.scoreboard import failures, headline, text
from zendsp.proof.seal import BrokenSeal, open_truth

# rooms below zendsp/ whose code gives the answers
JUDGED = ("diagnosis", "physics", "recording", "reference", "cli/diagnose.py")
COMMAND = (sys.executable, "-c", "from zendsp.cli import main; main()", "diagnose")


def diagnose(folder: Path, out: Path, limit: float, command: Sequence[str] = COMMAND) -> Answer:
    """Run the command on one case within `limit` seconds; never raises for what the command does."""
    listing = json.loads((folder / "case.json").read_text(encoding="utf-8"))
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.json").unlink(missing_ok=True)
    line = [
        *command,
        *(str(folder / name) for name in listing["train"]),
        "--model",
        str(folder / listing["model"]),
    ]
    for name in listing["heldout"]:
        line += ["--heldout", str(folder / name)]
    line += ["--out", str(out), "--json", "--jobs", "1"]
    env = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    begin = time.perf_counter()
    with (out / "stderr.txt").open("w") as errors, (out / "stdout.txt").open("w") as output:
        process = subprocess.Popen(line, stdout=output, stderr=errors, env=env, start_new_session=True)
        try:
            status = process.wait(limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            return Answer("", trouble=f"no answer within {limit:g} s", seconds=limit)
    seconds = time.perf_counter() - begin
    if status != 0:
        words = (out / "stderr.txt").read_text(errors="replace").strip().splitlines() or ["no words"]
        return Answer("", trouble=f"exit status {status}: {words[-1][:160]}", seconds=seconds)
    try:
        return read_report(out / "report.json", seconds)
    except (ContractError, KeyError, TypeError, ValueError) as error:
        return Answer("", trouble=f"broken report: {error}", seconds=seconds)


def identity(*rooms: str) -> str:
    """Hash of the code that answers: an answer of other code is not taken for one of this.

    Only bytes are read; nothing of the judged code is imported.
    """
    root = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256()
    for room in rooms or JUDGED:
        base = root / room
        for path in sorted(base.rglob("*")) if base.is_dir() else [base]:
            if path.suffix in (".py", ".c", ".h"):
                digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:16]


def known_answers(path: Path, code: str = "") -> dict[str, Answer]:
    """Answers of an interrupted run, one JSON line each; a line cut short, or of other code, is left out."""
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
) -> Iterator[tuple[str, Answer]]:
    """Yield (case, answer) as they come, those of an earlier run first; each new one is kept on disk at once."""
    log = out.with_suffix(".jsonl")
    log.parent.mkdir(parents=True, exist_ok=True)
    known = known_answers(log, code)
    yield from ((f.name, known[f.name]) for f in folders if f.name in known)
    todo = [f for f in folders if f.name not in known]
    reports = out.parent / f"{out.stem}_reports"
    with ThreadPoolExecutor(jobs) as pool:
        running = {pool.submit(ask, f, reports / f.name, limit): f.name for f in todo}
        for future in as_completed(running):
            name, answer = running[future], future.result()
            with log.open("a", encoding="utf-8") as file:
                file.write(json.dumps({"case": name, "code": code, "answer": answer.to_json()}) + "\n")
            yield name, answer


def write_results(path: Path, judged: Sequence[Judgement], stamp: str) -> None:
    """The judgements and the headline as JSON."""
    table = {
        "seals": stamp,
        "headline": [{"what": w.strip(), "measured": m, "wanted": x} for w, m, x in headline(judged)],
        "cases": [asdict(j) for j in judged],
    }
    path.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")


@click.command(context_settings={"help_option_names": ["-h", "--help"]})
@click.argument("cases", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.argument("truth", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--jobs", type=int, default=2, show_default=True)
@click.option(
    "--only", default="", help="Words; only cases whose truth has one as kind, machine, effect or name."
)
@click.option("--limit", type=float, default=120.0, show_default=True, help="Seconds per case.")
@click.option("--fresh", is_flag=True, help="Forget the answers of an earlier run.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("results.json"), show_default=True)
def main(cases: Path, truth: Path, jobs: int, only: str, limit: float, fresh: bool, out: Path) -> None:
    """Diagnose every case under CASES and compare with the sealed TRUTH."""
    try:
        truths = open_truth(truth)
    except BrokenSeal as error:
        raise click.ClickException(str(error)) from error
    wanted = set(only.replace(",", " ").split())
    chosen = [
        name
        for name, t in sorted(truths.items())
        if not wanted or wanted & {t["kind"], t["machine"], name, *(e["effect"] for e in t["effects"])}
    ]
    if fresh:
        out.with_suffix(".jsonl").unlink(missing_ok=True)
    judged: list[Judgement] = []
    folders = [cases / name for name in chosen]
    for count, (name, answer) in enumerate(answers(folders, out, jobs, limit, code=identity()), 1):
        j = judge(truths[name], answer)
        judged.append(j)
        mark = "FAIL" if failures([j]) else "ok"
        print(
            f"[{count}/{len(chosen)}] {name} {answer.seconds:5.1f} s {mark:4} {j.said[:110]}", file=sys.stderr
        )
    judged.sort(key=lambda j: j.case)
    write_results(out, judged, str(truth))
    print(text(judged, str(cases)))


if __name__ == "__main__":
    main()
