"""The real-time side: a native runner, the memory shared with it, and what is written to and read
from that memory. The network side uses it through `zendsp_target.api` only.
"""

from zendsp_target.runtime.memory.layout import outlive_lost_pages
from zendsp_target.runtime.runtime import Runtime, program_text

__all__ = ["Runtime", "outlive_lost_pages", "program_text"]
