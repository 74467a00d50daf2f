"""Shared memory: the layout that the runner declares in C, and the files that hold it."""
