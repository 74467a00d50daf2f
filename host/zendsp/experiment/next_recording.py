"""Makes the recording that a diagnosis proposes, on a target, and diagnoses again with it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from zendsp.diagnosis import Diagnosis, diagnose
from zendsp.diagnosis.progress import Progress, Step
from zendsp.diagnosis.report.files import no_reference
from zendsp.errors import ZendspError
from zendsp.experiment.separating import run_reference
from zendsp.link import connect
from zendsp.prompt import shows_progress
from zendsp.recording import Recording
from zendsp.reference import Reference, load_reference, save_reference

FILE = "next_recording.mat"


@shows_progress
def run_next(
    diagnosis: Diagnosis,
    recordings: Sequence[str | Path],
    target: str,
    folder: Path,
    *,
    heldout: Sequence[str | Path] | None = None,
    progress: Progress = lambda _text: None,
    **options: Any,
) -> Diagnosis:
    """Play the proposed reference on a target, keep the recording, and diagnose all recordings
    together.

    Parameters
    ----------
    diagnosis : Diagnosis
        The first one.
    recordings : sequence of path
        That it was made from.
    target : str
        Name of a target (``$ZENDSP_CONNECT`` says where, as for every command).
    folder : Path
        Receives next_reference.mat and next_recording.mat.
    progress : callable, optional
        Receives a sentence at each stage.
    **options
        For `zendsp.diagnose`: seed, jobs.

    Returns
    -------
    Diagnosis
        The second one; or the first, with a note, where it proposes no reference.

    Raises
    ------
    LinkError, Refused
        No such target, no program that follows the reference, or a limit in the way.
    """
    proposal = diagnosis.next_recording
    if proposal is None or proposal.reference is None:
        why = f"--run: {no_reference(diagnosis)}, so nothing was run on {target}"
        diagnosis.notes = (*diagnosis.notes, why)
        return diagnosis
    q, period = proposal.reference
    folder.mkdir(parents=True, exist_ok=True)
    path = save_reference(
        Reference(q, period, kind="separating", unit=diagnosis.units),
        folder / "next_reference.mat",
        check=False,
    )
    progress(Step.ANEW.says(f"running the separating experiment on {target}"))
    with connect(target) as machine:
        made = run_reference(machine, load_reference(path), diagnosis.given, _like(recordings))
    saved = made.save(folder / FILE)
    second = diagnose(
        [*recordings, saved], diagnosis.given, list(heldout) if heldout else None,
        progress=progress, **options,
    )
    second.notes = (*second.notes, f"with {saved.name}, recorded on {target}: {proposal.sentence}")
    return second


def _like(recordings: Sequence[str | Path]) -> Recording | None:
    """The first of the recordings that contains its program."""
    for path in recordings:
        try:
            recording = Recording.load(path)
        except (ZendspError, OSError, ValueError):
            continue
        if recording.sources:
            return recording
    return None
