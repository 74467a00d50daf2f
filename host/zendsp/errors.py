"""Re-exports the error tree, so that a user writes ``zendsp.errors.Refused``."""

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
    Tripped,
    VariableError,
    VersionMismatch,
    ZendspError,
    did_you_mean,
)

__all__ = [
    "AcquisitionError", "CompileFailed", "EndedWarning", "Incomplete", "LinkError", "ModelError",
    "NoAnswer", "NotApplied", "NotStopped", "NotYet", "RecordingError", "ReferenceError_",
    "Refused", "RunnerDied", "TooLarge", "Tripped", "VariableError", "VersionMismatch",
    "ZendspError", "did_you_mean",
]
