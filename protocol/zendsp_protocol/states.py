"""States and kinds as enums; on the wire, and when compared, each is its text."""

from __future__ import annotations

from enum import StrEnum


class _State(StrEnum):
    def __repr__(self) -> str:
        return repr(self.value)


class ProgramState(_State):
    """State of the program on a target."""

    EMPTY = "empty"  # none is loaded
    LOADED = "loaded"
    RUNNING = "running"
    PAUSED = "paused"
    STOPPED = "stopped"  # by a STOP or a trip, which is latched
    CRASHED = "crashed"


class TripReason(_State):
    """Why the drives are in the safe state."""

    STOP = "stop"
    STOP_INPUT = "stop input"
    HOST_LOST = "host lost"
    TORQUE = "torque"
    SPEED = "speed"
    POSITION = "position"
    COMMAND = "command"
    NAN = "nan"
    OVERRUN = "overrun"
    SENSOR = "sensor"
    HOMING = "homing"
    STALL = "stall"
    OUTSIDE = "outside"  # the code names a channel or joint that is not there
    OTHER = "other"  # told by a newer target: what it is stands in the sentence

    @classmethod
    def _missing_(cls, value: object) -> TripReason:
        return cls.OTHER


class Severity(_State):
    """Severity of a message of the compiler."""

    ERROR = "error"
    WARNING = "warning"
    NOTE = "note"

    @classmethod
    def _missing_(cls, value: object) -> Severity:
        return cls.ERROR  # "fatal error", "sorry, unimplemented": it ends there


# reasons of a trip that no limit has
STOPS = (TripReason.STOP, TripReason.STOP_INPUT, TripReason.HOST_LOST)


class DriveState(_State):
    """State of the drives in the safe sequence."""

    OFF = "off"
    READY = "ready"
    HOMED = "homed"
    ENABLED = "enabled"
    RUNNING = "running"
    STOPPED = "stopped"  # by somebody, or since who commanded is gone
    TRIPPED = "tripped"  # by a limit

    @classmethod
    def latched(cls, reason: TripReason) -> DriveState:
        """The state of the drives while a trip of this reason is latched."""
        return cls.STOPPED if reason in STOPS else cls.TRIPPED


LATCHED = (DriveState.STOPPED, DriveState.TRIPPED)  # until somebody acknowledges


class HostLost(_State):
    """What happens when the host that commands disappears while the program runs."""

    STOP = "stop"  # zero velocity, latched
    HOLD = "hold"  # the program's parameter `hold` is set
    FINISH = "finish"  # the program goes on


class RecorderState(_State):
    """State of one acquisition stream."""

    IDLE = "idle"
    ARMED = "armed"  # waits for its trigger
    RUNNING = "running"
    DONE = "done"


class VariableKind(_State):
    """Kind of a variable, by the macro that declares it."""

    PARAMETER = "parameter"  # the host may write it
    SIGNAL = "signal"  # it may read it
    TABLE = "table"  # large, in two banks
    BUILTIN = "builtin"  # a signal of every program
    SETTING = "setting"  # of the loop itself: limits, ramps


class Clock(_State):
    """The clock of a target's loop."""

    REAL = "real"
    FAST = "fast"  # as fast as the CPU allows; of simulated machines


class DriveMode(_State):
    """The mode in which the drives shall be."""

    OFF = "off"
    TORQUE = "torque"
    VELOCITY = "velocity"
    AUTO = "auto"  # is asked for, and never told: on at start, off at pause


class DriveAction(_State):
    """The action that a host asks of the drives."""

    TAKE = "take"  # the exclusive right to command
    RELEASE = "release"
    POWER_ON = "power_on"
    POWER_OFF = "power_off"
    HOME = "home"
    ENABLE = "enable"
    DISABLE = "disable"
    ACKNOWLEDGE = "acknowledge"  # what is latched
    AUTO = "auto"  # leave the explicit sequence
    HOST_LOST = "host_lost"  # choose a `HostLost`


class OverrunPolicy(_State):
    """What happens when samples take longer than the period."""

    COUNT = "count"
    SKIP = "skip"
    TRIP = "trip"  # after so many in a row
