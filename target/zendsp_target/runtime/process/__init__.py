"""The native runner as a process: its settings, its start, its watch and its end."""
