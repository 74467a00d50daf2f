"""The simulator of a whole machine."""
