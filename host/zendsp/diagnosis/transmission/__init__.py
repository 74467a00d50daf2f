"""Transmissions measured by sensors on both sides, or by a torque sensor within."""
