"""Names of experiments, and where their results are."""

from __future__ import annotations

from pathlib import Path

# what they were called before each ran on any machine
FORMER = {
    "imi-static": "breakaway",
    "imi-viscous": "high-speed",
    "imi-low-speed": "low-speed",
    "imi-fit": "friction-curve",
    "imi-circle": "circle",
    "pendulum-electrical": "electrical",
    "pendulum-mechanical": "mechanical",
    "pendulum-swing": "swing",
    "wam-friction": "friction",
    "wam-tracking": "tracking",
}


ENDED = "result_ended.toml"  # of one that ended early: nothing builds on it


def present_name(name: str) -> str:
    """The name that an experiment has now."""
    return FORMER.get(name, name)


def result_file(folder: Path, name: str) -> Path:
    """The result of an experiment in a folder, also of its former name; where there is none, the
    file that it goes to.
    """
    own = folder / name / "result.toml"
    before = [folder / old / "result.toml" for old, new in FORMER.items() if new == name]
    return next((file for file in (own, *before) if file.exists()), own)
