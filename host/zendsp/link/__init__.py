"""The link to a target: find it, connect, command it, watch it, record it."""

from zendsp.link.acquire import Trigger
from zendsp.link.connect import connect, local
from zendsp.link.find import Found, discover
from zendsp.link.live import LiveView
from zendsp.link.parameters import ParameterSet
from zendsp.link.rehearse import Rehearsal, rehearse
from zendsp.link.target import Target

__all__ = ["Found", "LiveView", "ParameterSet", "Rehearsal", "Target", "Trigger", "connect", "discover", "local", "rehearse"]
