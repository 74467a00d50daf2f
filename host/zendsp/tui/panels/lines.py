"""Lines of text that change often; only those that changed are painted."""

from __future__ import annotations

from rich.text import Text
from textual import events
from textual.geometry import Region, Size
from textual.strip import Strip
from textual.widget import Widget


class Lines(Widget):
    """Styled text without wrapping: a line that is too long ends in an ellipsis.

    Textual's Static lays out all of its text when one letter changes (3 ms for seven lines).
    """

    DEFAULT_CSS = "Lines { height: auto; }"

    def __init__(self, *, id: str | None = None, classes: str | None = None) -> None:
        super().__init__(id=id, classes=classes)
        self._lines: list[Text] = []
        self._strips: dict[int, Strip] = {}

    @property
    def text(self) -> str:
        """What is shown."""
        return "\n".join(line.plain for line in self._lines)

    def update(self, text: Text) -> None:
        """Show other text."""
        before, self._lines = self._lines, list(text.split("\n", allow_blank=True))
        if len(before) != len(self._lines):
            self._strips = {}
            self.refresh(layout=True)
            return
        for y, (old, new) in enumerate(zip(before, self._lines, strict=True)):
            if old != new or old.style != new.style:
                self._strips.pop(y, None)
                self.refresh(Region(0, y, self.size.width, 1))

    def notify_style_update(self) -> None:
        """Paint again, since the lines hold the colours of the theme."""
        self._strips = {}
        super().notify_style_update()

    def on_resize(self, event: events.Resize) -> None:
        self._strips = {}
        self.refresh()  # painted by then, perhaps, and a line that stays the same would stay cut

    def get_content_height(self, container: Size, viewport: Size, width: int) -> int:
        return len(self._lines)

    def render_line(self, y: int) -> Strip:
        back, width = self.rich_style, self.size.width
        if y not in self._strips or self._strips[y].cell_length != width:
            line = self._lines[y].copy() if y < len(self._lines) else Text()
            line.truncate(width, overflow="ellipsis")
            segments = line.render(self.app.console)
            strip = Strip(segments).apply_style(back)
            self._strips[y] = strip.adjust_cell_length(width, back)
        return self._strips[y]
