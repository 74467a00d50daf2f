"""What each reply holds. Field names and units are the contract; ``docs/protocol.md`` explains
them.

Readers ignore fields they do not know, and fields may be added with defaults: neither raises the
protocol version.
"""

from zendsp_protocol.messages.base import Empty, ErrorBody, Message, Said
from zendsp_protocol.messages.machine import (
    Condition,
    DriveStatus,
    JointInfo,
    Limits,
    MachineInfo,
    RunBegun,
)
from zendsp_protocol.messages.program import (
    Applied,
    Change,
    CompileResult,
    Diagnostic,
    Program,
    Reading,
    VariableInfo,
    Written,
)
from zendsp_protocol.messages.recorder import (
    AcquireStatus,
    ChunkHeader,
    Held,
    LiveHeader,
    LiveOpened,
    Replaced,
    Trigger,
)
from zendsp_protocol.messages.target import Info, Revealed, Seal, Status, Timing, Trip

__all__ = [
    "AcquireStatus", "Applied", "Change", "ChunkHeader", "CompileResult", "Condition",
    "Diagnostic", "DriveStatus", "Empty", "ErrorBody", "Held", "Info", "JointInfo", "Limits",
    "LiveHeader", "LiveOpened", "MachineInfo", "Message", "Program", "Reading", "Replaced",
    "Revealed", "RunBegun", "Said", "Seal", "Status", "Timing", "Trigger", "Trip",
    "VariableInfo", "Written",
]
