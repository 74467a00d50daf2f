"""Targets of this user on this computer: found, and stopped, without Zenoh or NumPy."""
