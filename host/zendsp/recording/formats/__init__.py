"""File formats: each reads a `Raw` table and writes a recording."""

from zendsp.recording.formats.raw import Raw

__all__ = ["Raw"]
