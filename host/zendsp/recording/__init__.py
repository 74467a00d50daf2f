"""Recordings: what a run measured, with everything needed to repeat it; and plain tables from other
programs.
"""

from zendsp.recording.recording import Channel, ParameterChange, Recording
from zendsp.recording.table import Table, read_table

__all__ = ["Channel", "ParameterChange", "Recording", "Table", "read_table"]
