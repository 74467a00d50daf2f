"""Where things are, by name: on the wire, and in Python, each is the text that it stands for."""

from __future__ import annotations

from enum import StrEnum

STOPS = ("stop", "stop input", "host lost")  # reasons of a trip that no limit has


class _State(StrEnum):
    def __repr__(self) -> str:
        return repr(self.value)


class ProgramState(_State):
    """Of the program on a target."""

    EMPTY = "empty"  # none is loaded
    LOADED = "loaded"
    RUNNING = "running"
    PAUSED = "paused"
    STOPPED = "stopped"  # by a STOP or a trip, which is latched
    CRASHED = "crashed"


class DriveState(_State):
    """Of the drives, in the safe sequence."""

    OFF = "off"
    READY = "ready"
    HOMED = "homed"
    ENABLED = "enabled"
    RUNNING = "running"
    STOPPED = "stopped"  # by somebody, or since who commanded is gone
    TRIPPED = "tripped"  # by a limit

    @classmethod
    def latched(cls, reason: str) -> DriveState:
        """What a latched trip makes of the drives, by its reason."""
        return cls.STOPPED if reason in STOPS else cls.TRIPPED


class RecorderState(_State):
    """Of one acquisition stream."""

    IDLE = "idle"
    ARMED = "armed"  # waits for its trigger
    RUNNING = "running"
    DONE = "done"
