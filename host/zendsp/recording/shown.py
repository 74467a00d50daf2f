"""A figure that a notebook shows by itself. Importing this module imports matplotlib."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A figure without pyplot: nothing keeps it open, and the last line of a cell shows it.

    A notebook shows figures of its own as soon as somebody imports pyplot there, and only then.
    """

    def _repr_png_(self) -> bytes:
        out = BytesIO()
        self.savefig(out, format="png", dpi=100)
        return out.getvalue()
