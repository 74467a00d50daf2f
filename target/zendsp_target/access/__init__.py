"""Where a target listens, who may come in, and what for."""
