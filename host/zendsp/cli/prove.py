"""``zendsp prove``: diagnoses concealed cases of several realities, real machines and implants, and
counts the answers.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from zendsp.cli.common import out_option
from zendsp.extras import installed, need
from zendsp.one_writer import one_writer

if TYPE_CHECKING:
    from zendsp.proof.programme import Prepared
    from zendsp.proof.run_proof import Outcome

FOLDER = click.Path(path_type=Path, file_okay=False)


def data_folder(given: Path | None) -> Path:
    """The folder of real recordings: ``--data``, else ``ZENDSP_DATA``."""
    if given is not None:
        return given
    named = os.environ.get("ZENDSP_DATA")
    if not named:
        raise click.UsageError(
            "real recordings are needed: give --data FOLDER or set ZENDSP_DATA to the folder that"
            " holds emps/, single_pendulum/, tx40/, kuka_kr300/"
        )
    return Path(named)


def realities(words: str) -> tuple[str, ...]:
    """The makers that ``--reality`` names; without it, all whose packages are installed."""
    from zendsp.proof.programme import REALITIES

    there = installed("mujoco")
    if not words:
        if not there:
            click.echo("without MuJoCo's reality: pip install 'zendsp[mujoco]'", err=True)
        return tuple(name for name in REALITIES if there or name != "mujoco")
    chosen = tuple(dict.fromkeys(word.strip() for word in words.split(",")))
    for word in chosen:
        if word not in REALITIES:
            raise click.UsageError(f"no reality {word!r}; known are {', '.join(REALITIES)}")
    if "mujoco" in chosen and not there:
        raise click.UsageError("the reality mujoco needs mujoco: pip install 'zendsp[mujoco]'")
    return chosen


@click.command("prove")
@click.option("--quick", is_flag=True, help="36 cases instead of some 1500.")
@click.option(
    "--reality",
    default="",
    metavar="NAMES",
    help=(
        "Who simulates the cases, comma separated: own, machines, mujoco. Default: all that are"
        " installed."
    ),
)
@click.option(
    "--jobs", type=click.IntRange(1), default=None, help="Cases at a time. Default: all cores."
)
@click.option(
    "--scheduler", default="", metavar="ADDRESS",
    help="Run on the Dask cluster of this scheduler (tcp://host:8786).",
)
@click.option(
    "--seed", type=click.IntRange(0), default=0, show_default=True, help="Draws other cases."
)
@click.option(
    "--sample", type=click.IntRange(1), default=None,
    help="Only so many of the cases, drawn by the seed: of each reality, and of every sort.",
)
@click.option(
    "--nulls", is_flag=True,
    help="Only the machines that lack nothing, 702: how many false alarms are there?",
)
@click.option(
    "--given",
    type=click.Choice(["urdf", "mjcf"]),
    default="urdf",
    show_default=True,
    help=(
        "mjcf: ask the cases of MuJoCo's arms that conceal a body a second time, their model given"
        " as MJCF, and compare the names."
    ),
)
@click.option(
    "--make", "make_only", type=FOLDER, default=None, help="Only write and seal the cases there."
)
@click.option(
    "--judge", "judge_only", type=FOLDER, default=None,
    help="Judge the cases that --make wrote there.",
)
@click.option(
    "--resume/--fresh", default=True, show_default=True,
    help="Go on where an interrupted run stopped, or begin again.",
)
@click.option(
    "--peers/--no-peers", default=True, show_default=True,
    help="Let PySINDy and FROLS try the same cases.",
)
@click.option(
    "--strict", is_flag=True,
    help="End with status 1 below the marks that tell a broken diagnosis, too.",
)
@click.option(
    "--limit", type=click.FloatRange(min=0, min_open=True), default=300.0, show_default=True,
    help="Seconds a diagnosis may take.",
)
@click.option(
    "--real", is_flag=True,
    help="Real machines instead: EMPS, a pendulum, a Stäubli TX40, a KUKA KR300.",
)
@click.option("--implant", is_flag=True, help="Known forces added to a real recording instead.")
@click.option("--only", default="", help="With --real and --implant: one machine.")
@click.option(
    "--fetch", is_flag=True, help="With --real: download what is absent and published as a file."
)
@click.option(
    "--data",
    type=click.Path(path_type=Path),
    default=None,
    help="Folder of real recordings. Default: ZENDSP_DATA.",
)
@out_option("Folder of the run. Default: proof_SEED below the working directory.")
@click.option(
    "--page",
    type=click.Path(path_type=Path),
    default=None,
    help="Also write the page there, for example docs/proof.md.",
)
def command(
    quick: bool,
    reality: str,
    jobs: int | None,
    scheduler: str,
    seed: int,
    sample: int | None,
    nulls: bool,
    given: str,
    make_only: Path | None,
    judge_only: Path | None,
    resume: bool,
    peers: bool,
    strict: bool,
    limit: float,
    real: bool,
    implant: bool,
    only: str,
    fetch: bool,
    data: Path | None,
    out: Path | None,
    page: Path | None,
) -> None:
    """Judge the diagnosis on machines whose physics it was not told.

    Concealed cases are simulated by code of their own, by the machines that ship as C, and by
    MuJoCo; the truth is sealed by hash before the first diagnosis and opened after the last. Exit
    status 0 when every case got an answer (with --strict: when the marks are reached too; with
    --real and --implant: when every promise was kept).

    Example:  zendsp prove --quick
    """
    # small matrices in many processes: more threads of the linear algebra only wait for each other
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    cores = jobs or os.cpu_count() or 1
    if real or implant:
        if fetch:
            fetch_absent(data_folder(data))
        folder = out or Path("proof_real")
        with _alone_in(folder, lambda: _kept_of_machines(folder, implant)):
            status = on_real_machines(
                data_folder(data), folder, limit, implant=implant, only=only, quick=quick,
                jobs=cores,
            )
        sys.exit(status)
    if make_only is not None and judge_only is not None:
        raise click.UsageError(
            "--make writes cases and --judge judges them: give one, or neither for both"
        )
    folder = judge_only or make_only or out or Path(f"proof_{'quick_' if quick else ''}{seed}")
    with _alone_in(folder, lambda: _kept_of_cases(folder)):
        try:
            if judge_only is not None:
                made, words = prepared(judge_only), f"zendsp prove --judge {judge_only.name}"
            else:
                # some cases are written as such files: better said now than after an hour
                for module, extra in (("pyarrow", "parquet"), ("h5py", "hdf5")):
                    need(module, extra, "zendsp prove")
                makers = realities(reality)
                if given == "mjcf" and "mujoco" not in makers:
                    raise click.UsageError(
                        "--given mjcf needs the reality mujoco: its arms are asked"
                    )
                if not resume:
                    forget(folder)
                from zendsp.proof.programme import prepare, requests

                wanted = requests(seed, quick, makers, sample or 0, given, nulls)
                made = prepare(folder, wanted, cores, scheduler)
                words = _words(makers, seed, quick, sample, given, nulls)
        except (FileExistsError, FileNotFoundError) as error:
            raise click.ClickException(str(error)) from error
        if make_only is not None:
            count = len(list(made.cases.iterdir()))
            click.echo(f"{count} cases in {made.cases}; truth sealed in {made.truth}: {made.stamp}")
            return
        outcome = judging(made, cores, scheduler, limit, peers, words)
    from zendsp.proof.scoreboard import missed_marks

    if page is not None:
        page.write_text(outcome.page.read_text(encoding="utf-8"), encoding="utf-8")
    missed = missed_marks(outcome.judged) if strict else []
    for line in missed:
        click.echo(f"below the mark: {line}", err=True)
    sys.exit(1 if missed or any(j.trouble for j in outcome.judged) else 0)


@contextmanager
def _alone_in(folder: Path, kept: Callable[[], str]) -> Iterator[None]:
    """Keep another proof out of the folder of a run. After Ctrl-C or SIGTERM it is printed what is
    kept, and how to go on; its children have ended by then.
    """
    with one_writer(folder, "zendsp prove"):
        try:
            yield
        except KeyboardInterrupt:
            click.echo(kept(), err=True)
            raise


def _kept_of_cases(folder: Path) -> str:
    """What a run that was interrupted has left in its folder."""
    note = folder / "programme.json"
    if not note.exists():
        return "nothing is made yet, nothing is kept"
    asked = json.loads(note.read_text(encoding="utf-8"))
    log = folder / "zendsp.jsonl"
    answered = len(log.read_text(encoding="utf-8").splitlines()) if log.exists() else 0
    made = len(list((folder / "cases").glob("case_*")))
    what = (
        f"{answered} of {made} cases answered"
        if asked["stamp"]
        else f"{made} of {len(asked['requests'])} cases made, none answered"
    )
    return (
        f"{folder} keeps what is done ({what}): the same command goes on there, --fresh begins anew"
    )


def _kept_of_machines(folder: Path, implant: bool) -> str:
    """What an interrupted run on real recordings has left in its folder."""
    if implant:
        return (
            f"{folder / 'implants'} keeps each diagnosis that has ended: the same command goes on"
            " there"
        )
    return (
        f"{folder} keeps the reports of the machines above: the same command begins with the first"
        " again, --only looks at one"
    )


def _words(
    makers: Sequence[str], seed: int, quick: bool, sample: int | None, given: str, nulls: bool
) -> str:
    """The command that makes the same cases again, for the page."""
    words = ["zendsp prove", *(["--quick"] if quick else [])]
    words.append(f"--reality {','.join(makers)} --seed {seed}")
    words += [f"--sample {sample}"] if sample else []
    words += ["--nulls"] if nulls else []
    return " ".join(words + (["--given mjcf"] if given == "mjcf" else []))


def prepared(folder: Path) -> Prepared:
    """The cases that ``--make`` wrote in a folder."""
    from zendsp.proof.programme import found

    return found(folder)


def judging(
    made: Prepared, jobs: int, scheduler: str, limit: float, peers: bool, words: str
) -> Outcome:
    """Judge prepared cases and print the scoreboard."""
    from zendsp.proof.run_proof import run_proof
    from zendsp.proof.scoreboard import rates, text
    from zendsp.proof.seal import BrokenSeal

    try:
        outcome = run_proof(
            made, jobs=jobs, limit=limit, with_peers=peers, command=words, scheduler=scheduler,
            tell=lambda line: click.echo(line, err=True),
        )  # fmt: skip
    except BrokenSeal as error:
        raise click.ClickException(str(error)) from error
    click.echo(text(outcome.judged, "zendsp"))
    for method, judged in outcome.peers.items():
        click.echo("\n" + rates(judged, method))
    click.echo(f"\ntruth sealed before, opened after: {outcome.stamp}\npage: {outcome.page}")
    return outcome


def forget(folder: Path) -> None:
    """Remove the files that a run of the proof wrote, and no others."""
    import shutil

    if not (folder / "programme.json").exists():
        return
    for name in ("cases", "truth", "zendsp_reports"):
        shutil.rmtree(folder / name, ignore_errors=True)
    for path in (*folder.glob("*.jsonl"), folder / "programme.json"):
        path.unlink(missing_ok=True)


def fetch_absent(data: Path) -> None:
    """Download the recordings that can be downloaded, and name the others."""
    from zendsp.proof import convert

    for machine in convert.FILES:
        for line in convert.fetch(machine, data, lambda text: click.echo(text, err=True)):
            click.echo(f"{machine}: {line}", err=True)


def on_real_machines(
    data: Path, out: Path, limit: float, *, implant: bool, only: str, quick: bool, jobs: int
) -> int:
    """Print the result for each real machine beside published values, or those of the implants;
    return the exit status.
    """
    from zendsp.proof import real

    if implant:
        from zendsp.proof.implant import implant_lines, run_implants
        from zendsp.proof.implant_wishes import WANTED

        if only and only not in WANTED:
            raise click.UsageError(f"no implants for {only!r}; known are {', '.join(WANTED)}")
        try:
            done = run_implants(
                data, out / "implants", limit, quick, only, jobs,
                lambda line: click.echo(line, err=True),
            )
        except (FileNotFoundError, RuntimeError) as error:
            raise click.ClickException(str(error)) from error
        click.echo("\n".join(implant_lines(done)))
        return 1 if any(i.broken for i in done) else 0
    known = [m.name for m in real.MACHINES]
    if only and only not in known:
        raise click.UsageError(f"no machine {only!r}; known are {', '.join(known)}")
    results = []
    for machine in real.MACHINES:
        if only in ("", machine.name):
            results.append((machine, real.look_at(machine, data, out, limit)))
            click.echo("\n".join(real.lines_of(*results[-1])))
    return real.main_status(results)
