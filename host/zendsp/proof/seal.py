"""The truth of each case as JSON, sealed by hash before any diagnosis runs and checked when it is
opened.
"""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from zendsp.errors import ZendspError
from zendsp.proof.truth import Truth

SEALS = "SEALS.sha256"


class BrokenSeal(ZendspError, ValueError):
    """A truth file is not what was sealed."""


def truth_text(truth: Truth) -> str:
    """Canonical JSON: sorted keys, so that equal truths have equal hashes."""
    return json.dumps(truth, sort_keys=True, indent=1, ensure_ascii=False) + "\n"


def write_truth(folder: Path, name: str, truth: Truth) -> None:
    """Write what a case conceals into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.json").write_text(truth_text(truth), encoding="utf-8")


def digest(path: Path) -> str:
    """SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def seal(folder: Path) -> str:
    """Write the hash of every truth file; returns the hash of that list, the one figure to write
    down.
    """
    lines = [f"{digest(path)}  {path.name}\n" for path in sorted(folder.glob("*.json"))]
    (folder / SEALS).write_text("".join(lines), encoding="utf-8")
    return digest(folder / SEALS)


def open_truth(folder: Path, expected: str | None = None) -> dict[str, Truth]:
    """Every truth by case name, after checking each against its seal.

    Parameters
    ----------
    expected : str, optional
        What :func:`seal` returned; with it, rewriting both a truth and the list of seals is noticed
        too.

    Raises
    ------
    BrokenSeal
        A file was altered, added or removed since it was sealed.
    """
    listed = folder / SEALS
    if not listed.exists():
        raise BrokenSeal(
            f"{folder} holds no {SEALS}: the truth was never sealed; make the cases again"
        )
    if expected is not None and digest(listed) != expected:
        raise BrokenSeal(
            f"{listed} was rewritten: its hash is {digest(listed)}, sealed was {expected}"
        )
    seals = {
        line.split("  ")[1]: line.split("  ")[0]
        for line in listed.read_text(encoding="utf-8").splitlines()
    }
    present = {path.name: path for path in folder.glob("*.json")}
    if set(present) != set(seals):
        odd = sorted(set(present) ^ set(seals))
        raise BrokenSeal(f"truth files added or removed since the sealing: {', '.join(odd[:5])}")
    for name, path in present.items():
        if digest(path) != seals[name]:
            raise BrokenSeal(f"{path} was altered after it was sealed")
    return {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in present.values()}
