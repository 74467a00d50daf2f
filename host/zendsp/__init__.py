"""zendsp: rapid control prototyping over a network link."""

from __future__ import annotations

from zendsp.first_use import on_first_use

__version__ = "0.1.0"

# name -> module that holds it; imported on first use, so that `import zendsp` costs milliseconds
_LAZY = {
    "connect": "zendsp.link",
    "local": "zendsp.link",
    "discover": "zendsp.link",
    "find_salvage": "zendsp.link",
    "Target": "zendsp.link",
    "Trigger": "zendsp.link",
    "ParameterSet": "zendsp.link",
    "rehearse": "zendsp.link",
    "Recording": "zendsp.recording",
    "read_table": "zendsp.recording",
    "diagnose": "zendsp.diagnosis",
    "frequency_response": "zendsp.experiment",
    "sweep": "zendsp.experiment",
    "simulate": "zendsp.physics",
    "simulate_loop": "zendsp.physics",
    "MatDSPconnect": "zendsp.matdsp",
    "MatDSPclose": "zendsp.matdsp",
    "MatDSPcompile": "zendsp.matdsp",
    "MatDSPdownload": "zendsp.matdsp",
    "MatDSPstart": "zendsp.matdsp",
    "MatDSPpause": "zendsp.matdsp",
    "MatDSPstop": "zendsp.matdsp",
    "MatDSPacknowledge": "zendsp.matdsp",
    "MatDSPvariable": "zendsp.matdsp",
    "MatDSPdiscard": "zendsp.matdsp",
    "MatDSPupdate": "zendsp.matdsp",
    "MatDSPAcquireConfig": "zendsp.matdsp",
    "MatDSPAcquireLoad": "zendsp.matdsp",
}

# `zendsp.physics.load_effects` works after `import zendsp` alone
_ROOMS = (
    "bridge", "diagnosis", "experiment", "link", "matdsp", "physics", "proof", "recording",
    "reference",
)  # fmt: skip

TYPE_CHECKING = False  # what `typing` has, without its import: a command begins with this file
if TYPE_CHECKING:
    from zendsp import bridge as bridge
    from zendsp import diagnosis as diagnosis
    from zendsp import experiment as experiment
    from zendsp import link as link
    from zendsp import matdsp as matdsp
    from zendsp import physics as physics
    from zendsp import proof as proof
    from zendsp import recording as recording
    from zendsp import reference as reference
    from zendsp.experiment import frequency_response as frequency_response
    from zendsp.experiment import sweep as sweep
    from zendsp.link import ParameterSet as ParameterSet
    from zendsp.link import Target as Target
    from zendsp.link import Trigger as Trigger
    from zendsp.link import connect as connect
    from zendsp.link import discover as discover
    from zendsp.link import find_salvage as find_salvage
    from zendsp.link import local as local
    from zendsp.link import rehearse as rehearse
    from zendsp.matdsp import MatDSPacknowledge as MatDSPacknowledge
    from zendsp.matdsp import MatDSPAcquireConfig as MatDSPAcquireConfig
    from zendsp.matdsp import MatDSPAcquireLoad as MatDSPAcquireLoad
    from zendsp.matdsp import MatDSPclose as MatDSPclose
    from zendsp.matdsp import MatDSPcompile as MatDSPcompile
    from zendsp.matdsp import MatDSPconnect as MatDSPconnect
    from zendsp.matdsp import MatDSPdiscard as MatDSPdiscard
    from zendsp.matdsp import MatDSPdownload as MatDSPdownload
    from zendsp.matdsp import MatDSPpause as MatDSPpause
    from zendsp.matdsp import MatDSPstart as MatDSPstart
    from zendsp.matdsp import MatDSPstop as MatDSPstop
    from zendsp.matdsp import MatDSPupdate as MatDSPupdate
    from zendsp.matdsp import MatDSPvariable as MatDSPvariable
    from zendsp.physics import simulate as simulate
    from zendsp.physics import simulate_loop as simulate_loop
    from zendsp.recording import Recording as Recording
    from zendsp.recording import read_table as read_table

__all__ = ["__version__", *_LAZY]

__getattr__ = on_first_use(__name__, _LAZY, _ROOMS)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY, *_ROOMS})
