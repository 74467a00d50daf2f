"""The compensation of a diagnosis as numbers for the running program, and the program that can take
them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from zendsp.diagnosis.report.files import stands_for
from zendsp.errors import ZendspError
from zendsp.physics import load_model
from zendsp.physics.codegen.compensation import SETTINGS, SHARE, compensation_values
from zendsp.physics.codegen.terms import compensable, why_not
from zendsp.tui.diagnoses import Diagnosed
from zendsp_protocol.messages import Program
from zendsp_protocol.values import Value

FILE = "compensation.c"
LINES = """    #include "compensation.c"                         after isr.h
    CompensationInit();                               in UserInit
    tau[j] += Compensation(j, q, qd, qdd, tau[j]);    in UserISR_INT2, for each joint"""


@dataclass(frozen=True)
class Compensation:
    """The numbers of one diagnosis, by the names that its compensation.c gives them."""

    values: Mapping[str, float]
    source: Path  # compensation.c of the report
    left_out: tuple[str, ...]  # what a torque cannot cancel, and why

    def fits(self, names: Iterable[str]) -> bool:
        """Whether a program with these variables takes these numbers and no others."""
        own = {n for n in names if n.startswith("comp_") and n not in SETTINGS}
        return bool(self.values) and own == set(self.values)

    def acts(self, present: Mapping[str, Value]) -> bool:
        """Whether a program with these values adds the compensation now."""
        same = all(float(present.get(n, float("nan"))) == v for n, v in self.values.items())
        return same and float(present.get(SHARE, 0.0)) > 0.0


def compensation_of(d: Diagnosed) -> Compensation:
    """The compensation of those findings that a torque can cancel.

    Raises
    ------
    ZendspError
        The improved model is not one that has C.
    """
    model = load_model(d.folder / "model.toml")
    found = stands_for(d.report)
    terms = [t for t in model.terms if (t.effect, t.joint) in found]
    left_out = tuple(
        f"Not compensated: {t.effect} of joint {t.joint} ({why_not(t.effect)})."
        for t in terms
        if not compensable(t)
    )
    return Compensation(compensation_values(terms, model), d.folder / FILE, left_out)


def has_room(sources: Mapping[str, str]) -> bool:
    """Whether a program includes a compensation.c and calls it."""
    text = "\n".join(sources.values())
    return f'"{FILE}"' in text and "CompensationInit" in text


def written_out(program: Program, root: Path) -> tuple[Path, dict[str, str]]:
    """Where the loaded program is to be written in a folder, and its sources without a
    compensation.

    Raises
    ------
    ZendspError
        It cannot go there: nothing is known of it, or another file is in its place.
    """
    texts = {name: text for name, text in program.sources.items() if name != FILE}
    main = next((name for name in texts if name.endswith(".c")), None)
    if main is None:
        raise ZendspError("the target does not know the source of its program")
    for name, text in texts.items():
        place = root / name
        if not place.resolve().is_relative_to(root.resolve()):
            raise ZendspError(f"{name} of the running program does not belong into {root}")
        if place.exists() and place.read_text(encoding="utf-8", errors="replace") != text:
            raise ZendspError(f"{place} is not the {name} that runs")
    return root / main, texts
