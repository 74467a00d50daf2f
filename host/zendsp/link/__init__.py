"""The link to a target: find it, connect, command it, watch it, record it."""

from zendsp.link.acquire import Trigger
from zendsp.link.connect import connect, local
from zendsp.link.find import Found, discover
from zendsp.link.live import LiveView
from zendsp.link.parameters import ParameterSet
from zendsp.link.rehearse import Rehearsal, rehearse
from zendsp.link.salvage import Salvage, find_salvage
from zendsp.link.target import Target

__all__ = [
    "Found", "LiveView", "ParameterSet", "Rehearsal", "Salvage", "Target", "Trigger", "connect",
    "discover", "find_salvage", "local", "rehearse",
]
