"""Machines with concealed physics, simulated by code and numerics that the diagnosis does not
share.
"""

from zendsp.proof.reality.machine import (
    CouplingTruth,
    ForeignTable,
    JointTruth,
    LinkTruth,
    MachineTruth,
    Run,
    inverse_dynamics,
    run,
)

__all__ = [
    "CouplingTruth", "ForeignTable", "JointTruth", "LinkTruth", "MachineTruth", "Run",
    "inverse_dynamics", "run",
]
