"""Re-exports the error tree, so that a user writes ``zendsp.errors.Refused``, and reads that name
in a traceback.
"""

from zendsp_protocol.errors import (
    AcquisitionError,
    CompileFailed,
    EndedWarning,
    Incomplete,
    LinkError,
    ModelError,
    NoAnswer,
    NotApplied,
    NotStopped,
    NotYet,
    RecordingError,
    ReferenceError_,
    Refused,
    RunnerDied,
    TooLarge,
    TooSoon,
    Tripped,
    Unmeasured,
    VariableError,
    VersionMismatch,
    ZendspError,
    did_you_mean,
)

__all__ = [
    "AcquisitionError", "CompileFailed", "EndedWarning", "Incomplete", "LinkError", "ModelError",
    "NoAnswer", "NotApplied", "NotStopped", "NotYet", "RecordingError", "ReferenceError_",
    "Refused", "RunnerDied", "TooLarge", "TooSoon", "Tripped", "Unmeasured", "VariableError",
    "VersionMismatch", "ZendspError", "did_you_mean",
]

for _name in __all__:
    globals()[_name].__module__ = __name__
