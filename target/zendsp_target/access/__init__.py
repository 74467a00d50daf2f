"""Access to a target: where it listens, who may connect, and what for."""
