"""The folder in which a terminal works: references, runs and parameter sets, as plain files."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from zendsp.recording.table import READERS
from zendsp.reference.files import is_reference

ENTRY = re.compile(rb"void\s+UserISR_INT2\s*\(")  # in every program (isr.h)
MOST = 200  # files that a list is made of


def file_name(text: str) -> str:
    """A text as a file name that every file system accepts."""
    return re.sub(r"[^\w.+-]+", "_", text.strip()).strip("._") or "unnamed"


@dataclass(frozen=True)
class Workspace:
    """The folders of a terminal; each is made when something is saved in it."""

    root: Path

    @property
    def references(self) -> Path:
        """Planned motions, MAT."""
        return self.root / "references"

    @property
    def runs(self) -> Path:
        """One folder for each run."""
        return self.root / "runs"

    @property
    def diagnoses(self) -> Path:
        """One folder for each diagnosis."""
        return self.root / "diagnoses"

    @property
    def sweeps(self) -> Path:
        """Tables of sweeps, CSV."""
        return self.root / "sweeps"

    @property
    def sets(self) -> Path:
        """Parameter sets, JSON."""
        return self.root / "sets"

    def free(self, folder: Path, stem: str, suffix: str) -> Path:
        """A path in ``folder``, made of ``stem``, that does not exist yet."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{file_name(stem)}{suffix}"
        n = 2
        while path.exists():
            path = folder / f"{file_name(stem)}-{n}{suffix}"
            n += 1
        return path

    def has_references(self) -> bool:
        """Whether there are any saved references; as soon as one is found."""
        return any(map(is_reference, self._may_be_references()))

    def saved_references(self) -> list[Path]:
        """The references of this folder and of those directly below it, newest first; hidden
        folders are left out.
        """
        return [p for p in self._may_be_references() if is_reference(p)]

    def _may_be_references(self) -> list[Path]:
        found = [*self.references.glob("*.mat"), *self.root.glob("*.mat")]
        below = self.root.glob("*/*.mat")
        found += [p for p in below if not p.parent.name.startswith(".") and p not in found]
        dated = sorted(((p.stat().st_mtime, p) for p in found), reverse=True)
        return [p for _, p in dated[:MOST]]

    def recordings(self) -> list[Path]:
        """The files of recordings in this folder and in those directly below it, newest first;
        references and hidden folders are left out.
        """
        kinds = tuple(kind for kind in READERS if kind not in (".txt", ".log"))  # mostly others
        found = [p for depth in ("*", "*/*") for p in self.root.glob(depth)]
        files = [
            p
            for p in found
            if p.name.endswith(kinds) and p.is_file() and not p.parent.name.startswith(".")
        ]
        dated = sorted(((p.stat().st_mtime, p) for p in files), reverse=True)
        return [p for _, p in dated[:MOST] if not (p.suffix == ".mat" and is_reference(p))]

    def sources(self) -> tuple[list[Path], list[Path]]:
        """The control programs in this folder and below it, and the C files that programs include;
        the nearest first, then the newest. Hidden folders are left out.
        """
        found = list(self.root.glob("*.c"))
        found += [p for p in self.root.glob("*/*.c") if not p.parent.name.startswith(".")]
        dated = sorted(found, key=lambda p: (p.parent != self.root, -p.stat().st_mtime, p))[:MOST]
        programs = [p for p in dated if _is_program(p)]
        return programs, [p for p in dated if p not in programs]


def _is_program(path: Path) -> bool:
    """Whether a C file has the function that runs every sample."""
    try:
        return ENTRY.search(path.read_bytes()) is not None
    except OSError:
        return False
