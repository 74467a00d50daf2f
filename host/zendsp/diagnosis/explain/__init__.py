"""The explanation of recordings: of every joint, of the machine, and of what pushes it."""
