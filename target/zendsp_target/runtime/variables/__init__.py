"""The variables of a loaded program: dictionary, values, synchronous updates, the log."""
