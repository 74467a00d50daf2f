"""Bridges: a running target in the viewers that people have."""

from zendsp.bridge.foxglove import Bridge, foxglove
from zendsp.bridge.rerun_viewer import rerun

__all__ = ["Bridge", "foxglove", "rerun"]
