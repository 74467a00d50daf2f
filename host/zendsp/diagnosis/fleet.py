"""Many recordings, each diagnosed on its own against one model: on this machine's cores, or on a
Dask cluster.

Each diagnosis is one task that returns its report as plain numbers and strings, so that nothing but
files and dictionaries crosses between processes and machines. On a cluster the recordings, the
model and the output folder must be readable under the same paths by every worker.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from zendsp.cluster import connect
from zendsp.diagnosis.decide.contract import Report
from zendsp.errors import ZendspError
from zendsp.prompt import shows_progress
from zendsp_protocol.views import with_std

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Item:
    """Outcome of one recording: its report (report.json of the contract), or the reason that there
    is none.
    """

    recording: str
    report: Report | None
    error: str = ""


@shows_progress
def diagnose_each(
    recordings: Sequence[str | Path],
    model: str | Path,
    heldout: Sequence[str | Path] = (),
    *,
    out: str | Path | None = None,
    pictures: bool = True,
    seed: int = 0,
    jobs: int = 1,
    effects: Sequence[str | Path] = (),
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> list[Item]:
    """Diagnose every recording on its own against the same model.

    Parameters
    ----------
    heldout : sequence of path
        Judged on by all of them; where none is given the last third of each is held out (of its
        motion, where it comes to rest).
    out : path, optional
        Folder; each recording's report goes into a folder of its name below it.
    pictures : bool
        Also report.html and its figures.
    jobs : int
        Processes on this machine; a cluster decides for itself.
    effects : sequence of path
        Files of the user's own effects.
    scheduler : str, optional
        Address of a Dask scheduler, ``"tcp://host:8786"``; local processes where None.
    progress : callable, optional
        Receives a sentence after each recording.

    Returns
    -------
    list of Item
        In the order of the recordings; unusable recordings carry their error.

    Raises
    ------
    ZendspError
        ``distributed`` is not installed.
    LinkError
        The scheduler does not answer.
    """
    names = [str(Path(r).resolve()) for r in recordings]
    folders = [None if out is None else str((Path(out) / stem).resolve()) for stem in stems(names)]
    rest = (
        str(Path(model).resolve()),
        [str(Path(h).resolve()) for h in heldout],
        seed,
        [str(Path(e).resolve()) for e in effects],
        pictures,
    )
    tasks = [(name, folder, *rest) for name, folder in zip(names, folders, strict=True)]
    done: dict[str, Item] = {}
    tell = progress or (lambda _text: None)
    for item in _local(tasks, jobs) if scheduler is None else _cluster(tasks, scheduler):
        done[item.recording] = item
        tell(f"{len(done)} of {len(tasks)} recordings diagnosed; last {Path(item.recording).name}")
    return [done[name] for name in names]


def stems(names: Sequence[str]) -> list[str]:
    """A folder name for each recording: its file's name without suffix, with its place in the list
    where two would be the same.
    """
    short = [Path(n).name.split(".")[0] for n in names]
    return [s if short.count(s) == 1 else f"{k}_{s}" for k, s in enumerate(short, 1)]


def diagnose_one(task: tuple[str, str | None, str, list[str], int, list[str], bool]) -> Item:
    """One recording, in whichever process: errors that are expected come back as sentences."""
    name, folder, model, heldout, seed, effects, pictures = task
    try:
        from zendsp.diagnosis.engine import diagnose
        from zendsp.physics.effects import load_effects

        for file in effects:
            load_effects(file)
        result = diagnose(name, model, heldout or None, seed=seed, jobs=1)
        if folder is not None:
            from zendsp.diagnosis.report.files import write_report

            write_report(result, folder, pictures=pictures)
        return Item(name, result.report())
    except ZendspError as error:
        return Item(name, None, str(error))


def _local(tasks: Sequence[Any], jobs: int) -> Iterator[Item]:
    if jobs == 1 or len(tasks) == 1:
        yield from map(diagnose_one, tasks)
        return
    # spawned, not forked: this process may hold threads and opened libraries
    with ProcessPoolExecutor(
        min(jobs, len(tasks)), mp_context=multiprocessing.get_context("spawn")
    ) as pool:
        for future in as_completed([pool.submit(diagnose_one, task) for task in tasks]):
            yield future.result()


def _cluster(tasks: Sequence[Any], address: str) -> Iterator[Item]:
    client = connect(address)
    from distributed import as_completed as completed

    with client:
        # pure=False: the same recording with another model in the same place is another task
        for future in completed(client.map(diagnose_one, tasks, pure=False)):
            yield future.result()


def table(items: Sequence[Item], common: bool = True) -> str:
    """One line a recording: verdict, findings with their first parameter, held-out error calibrated
    to improved.

    Parameters
    ----------
    common : bool
        Append what the recordings agree on.
    """
    width = max([len(Path(i.recording).name) for i in items] + [9])
    lines = [
        f"{'recording':<{width}}  {'verdict':<11}  {'calibrated':>10}  {'improved':>10}  findings"
    ]
    tally: dict[tuple[str, int], int] = {}
    for item in items:
        name = Path(item.recording).name
        if item.report is None:
            lines.append(f"{name:<{width}}  {'unusable':<11}  {'':>10}  {'':>10}  {item.error}")
            continue
        found = []
        for f in item.report["findings"]:
            key = (f["effect"], f["joint"])
            tally[key] = tally.get(key, 0) + 1
            first = [
                f" {name} {with_std(e['value'], e['std'], e['unit'])}"
                for name, e in list(f["parameters"].items())[:1]
            ]
            found.append(f"{f['effect']} (joint {f['joint']}){''.join(first)}")
        held = item.report["fit"]["heldout"]
        lines.append(
            f"{name:<{width}}  {item.report['verdict']:<11}  {held['calibrated']:>10.3g} "
            f" {held['improved']:>10.3g}  {'; '.join(found)}"
        )
    usable = sum(i.report is not None for i in items)
    if common and tally:
        lines += [
            "",
            *[
                f"{effect}, joint {joint}: in {count} of {usable} recordings"
                for (effect, joint), count in sorted(tally.items(), key=lambda t: -t[1])
            ],
        ]
    return "\n".join(lines)
