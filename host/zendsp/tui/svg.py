"""Makes exported screenshots look the same everywhere: braille is drawn as dots, and no font is
loaded from the network.
"""

from __future__ import annotations

import html
import re

_TEXT = re.compile(
    r'<text class="(?P<cls>[^"]+)" x="(?P<x>[-\d.]+)" y="(?P<y>[-\d.]+)"'
    r' textLength="(?P<len>[-\d.]+)"'
    r"(?P<rest>[^>]*)>(?P<text>[^<]*)</text>"
)
_FACE = re.compile(r"@font-face \{.*?\}", re.DOTALL)
LINE = 24.4  # height of a line in Rich's export, px
BASE = 18.5  # from the top of a line to its baseline, px
# (column, row) of each bit of a braille code
_DOTS = ((0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (0, 3), (1, 3))


def portable(svg: str) -> str:
    """An exported screenshot with its curves as shapes, in the reader's own monospaced font.

    Few viewers have a monospaced font with braille, and a README may not load fonts; so each
    braille character becomes its dots.

    Parameters
    ----------
    svg : str
        From ``App.export_screenshot()``.
    """
    svg = _FACE.sub("", svg).replace("font-family: Fira Code, monospace", "font-family: monospace")
    svg = svg.replace("Fira Code", "DejaVu Sans Mono, Menlo, Consolas, monospace")
    return _TEXT.sub(_redraw, svg)


def _redraw(match: re.Match[str]) -> str:
    text = html.unescape(match["text"])
    if not any("\u2800" < c <= "\u28ff" for c in text):
        return match[0]
    x, y, width = float(match["x"]), float(match["y"]), float(match["len"]) / len(text)
    path, rest = [], []
    for k, c in enumerate(text):
        code = ord(c) - 0x2800
        if 0 < code < 256:
            for bit, (column, row) in enumerate(_DOTS):
                if code >> bit & 1:
                    cx = x + (k + (column + 0.5) / 2.0) * width
                    cy = y - BASE + (row + 0.5) / 4.0 * LINE
                    path.append(f"M{cx - 1.9:.1f} {cy:.1f}a1.9 1.9 0 1 0 3.8 0a1.9 1.9 0 1 0-3.8 0")
            rest.append("\u00a0")
        else:
            rest.append(c)
    drawn = f'<path class="{match["cls"]}" d="{"".join(path)}"/>'
    left = "".join(rest)
    if not left.strip("\u00a0 "):
        return drawn
    words = (
        f'<text class="{match["cls"]}" x="{match["x"]}" y="{match["y"]}"'
        f' textLength="{match["len"]}"{match["rest"]}>'
    )
    return drawn + words + html.escape(left) + "</text>"
