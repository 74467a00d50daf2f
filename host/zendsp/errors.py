"""Re-exports the error tree, so that a user writes ``zendsp.errors.Refused``."""

from zendsp_protocol.errors import (
    AcquisitionError,
    CompileFailed,
    LinkError,
    ModelError,
    NoAnswer,
    RecordingError,
    ReferenceError_,
    Refused,
    RunnerDied,
    StaleValues,
    VariableError,
    VersionMismatch,
    ZendspError,
    did_you_mean,
)

__all__ = [
    "AcquisitionError",
    "CompileFailed",
    "LinkError",
    "ModelError",
    "NoAnswer",
    "RecordingError",
    "ReferenceError_",
    "Refused",
    "RunnerDied",
    "StaleValues",
    "VariableError",
    "VersionMismatch",
    "ZendspError",
    "did_you_mean",
]
