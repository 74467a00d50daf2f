"""Layouts of the scope by name: one JSON file each, in the user's folder of settings."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import msgspec

from zendsp.errors import ZendspError
from zendsp.tui.scope.formula import Formula
from zendsp.tui.scope.settings import LANES, MOST_CHANNELS, VIEWS, Channel, Scale, ScopeSettings
from zendsp.whole_file import write_whole
from zendsp_protocol import written
from zendsp_protocol.spelling import unknown_keys

FORM = 1


@dataclass(frozen=True)
class Layout:
    """What the scope shows and how; no data."""

    channels: tuple[Channel, ...]
    settings: ScopeSettings


def layouts_folder() -> Path:
    """The folder of layouts: under ``$XDG_CONFIG_HOME``, else ``~/.config``."""
    root = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(root) / "zendsp" / "layouts"


def save_layout(layout: Layout, path: Path) -> Path:
    """Write a layout as JSON that a person can read and edit."""
    body = {"zendsp_layout": FORM, **asdict(layout)}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(body, indent=2) + "\n")
    except OSError as error:
        raise ZendspError(f"{path}: cannot be written ({error.strerror})") from error
    return path


def load_layout(path: Path) -> Layout:
    """Read a layout.

    Raises
    ------
    ZendspError
        The file is no layout, or one of its values is impossible.
    """
    try:
        body = written.json(path.read_text(encoding="utf-8"))
        if body["zendsp_layout"] != FORM:
            raise ValueError(f"layout {body['zendsp_layout']}, this zendsp reads {FORM}")
        if said := _mistyped(body, str(path)):
            raise ZendspError(said)
        layout = msgspec.convert(body, Layout)
        _check(layout.channels, layout.settings)
        return layout
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        words = f"{type(error).__name__}: {error}"
        raise ZendspError(f"{path}: is not a layout of the scope ({words})") from error


def _mistyped(body: Any, where: str) -> str:
    """A sentence on keys of a layout that do not exist."""
    settings, scales = body["settings"], body["settings"].get("scales", {})
    tables = [
        (body, ("zendsp_layout", *_names(Layout)), f"{where}: the file"),
        *((c, _names(Channel), f"{where}: curve {n}") for n, c in enumerate(body["channels"], 1)),
        (settings, _names(ScopeSettings), f"{where}: settings"),
        *((scale, _names(Scale), f"{where}: scale of {name}") for name, scale in scales.items()),
    ]
    return "\n".join(filter(None, (unknown_keys(*table) for table in tables)))


def _names(kind: Any) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


def _check(channels: tuple[Channel, ...], s: ScopeSettings) -> None:
    """Refuse settings that the scope could not draw; the file may have been edited."""
    for channel in channels:
        if channel.formula:
            Formula.read(f"{channel.name} = {channel.formula}")
    last = max(len(channels) - 1, 0)
    possible = {
        "channels": len(channels) <= MOST_CHANNELS,
        "view": s.view in VIEWS,
        "lanes": s.lanes in LANES,
        "mode": s.mode in ("roll", "trigger"),
        "edge": s.edge in ("rising", "falling", "both"),
        "window": 1e-3 <= s.window <= 1e3,
        "level": abs(s.level) < 1e300,
        "active": s.active in ("a", "b"),
        "selected": 0 <= s.selected <= last,
        "source": 0 <= s.source <= last,
        "pre": 0.0 <= s.pre <= 1.0,
        "cursor_a": 0.0 <= s.cursor_a <= 1.0,
        "cursor_b": 0.0 <= s.cursor_b <= 1.0,
    }
    wrong = [name for name, good in possible.items() if not good]
    if wrong:
        raise ValueError(f"impossible value of {', '.join(wrong)}")
