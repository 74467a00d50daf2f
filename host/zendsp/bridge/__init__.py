"""Bridges: show a running target in other viewers."""

from zendsp.bridge.foxglove import Bridge, foxglove
from zendsp.bridge.rerun_viewer import rerun

__all__ = ["Bridge", "foxglove", "rerun"]
