"""What is concealed in a MuJoCo reality, by effect: MuJoCo's own parts where it has them, else
formulas of ours.

Each maker changes the bench and returns the truth in the words of the contract. Sizes are shares of
the RMS torque.
"""

from __future__ import annotations

from zendsp.proof.mujoco import drive, friction, mechanics
from zendsp.proof.mujoco.kit import MAKERS

__all__ = ["MAKERS", "drive", "friction", "mechanics"]  # each enters its makers into the table
