"""A user's own simulator that can only be called."""
