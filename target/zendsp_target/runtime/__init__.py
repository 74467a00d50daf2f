"""The real-time side: a native runner, the memory that is shared with it, and what is written to
and read from it. `zendsp_target.api` is all that the network may ask of it.
"""

from zendsp_target.runtime.runtime import Runtime, program_text

__all__ = ["Runtime", "program_text"]
