from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest


@pytest.fixture(scope="session", autouse=True)
def drawn_once() -> Iterator[None]:
    """A picture of an experiment is laid out and drawn in the first test that has one of as many
    panels, with all that may fail there. The others get a copy of it: nobody looks at them, and
    they took a third of the processor's time of an experiment.
    """
    from matplotlib.figure import Figure

    drawn: dict[tuple[str, str, int], bytes] = {}
    savefig = Figure.savefig

    def once(self: Figure, file: Any, **options: Any) -> None:
        if not isinstance(file, Path):
            savefig(self, file, **options)
            return
        key = (file.parent.name, file.name, len(self.axes))
        if key in drawn:
            file.write_bytes(drawn[key])
        else:
            savefig(self, file, **options)
            drawn[key] = file.read_bytes()

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(Figure, "savefig", once)
        yield
