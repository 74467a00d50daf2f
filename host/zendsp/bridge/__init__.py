"""Bridges: a running target in the viewers that people have."""

from zendsp.bridge.foxglove import Bridge, foxglove

__all__ = ["Bridge", "foxglove"]
