"""Machines with concealed physics, simulated by code and numerics that the diagnosis does not share."""

from zendsp.proof.reality.machine import (
    CouplingTruth,
    JointTruth,
    LinkTruth,
    MachineTruth,
    Run,
    inverse_dynamics,
    run,
)

__all__ = ["CouplingTruth", "JointTruth", "LinkTruth", "MachineTruth", "Run", "inverse_dynamics", "run"]
