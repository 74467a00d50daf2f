"""Model files: read, written, found, and drafted from a recording."""
