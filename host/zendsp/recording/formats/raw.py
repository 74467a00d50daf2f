"""What a file holds before anyone has decided what it means."""

from __future__ import annotations

from dataclasses import dataclass, field

from zendsp.recording.names import FloatArray


@dataclass(frozen=True)
class Raw:
    """Named arrays as the file has them.

    ``columns`` may still differ in length; ``circumstances`` is the JSON text that zendsp writes
    beside its own data, empty in foreign files; ``refused`` names what is there but holds no
    numbers, with the reason; ``notes`` say what the reader did to the numbers.
    """

    columns: dict[str, FloatArray]
    units: dict[str, str] = field(default_factory=dict)
    constants: dict[str, float] = field(default_factory=dict)
    circumstances: str = ""
    refused: dict[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
