"""The oscilloscope of the terminal: numpy raster of braille dots, history, trigger, cursors."""

from zendsp.tui.scope.history import History
from zendsp.tui.scope.raster import encode, envelope, fill
from zendsp.tui.scope.settings import Channel, Scale, ScopeSettings
from zendsp.tui.scope.widget import NO_CHANNELS, Scope

__all__ = [
    "NO_CHANNELS", "Channel", "History", "Scale", "Scope", "ScopeSettings", "encode", "envelope",
    "fill",
]  # fmt: skip
