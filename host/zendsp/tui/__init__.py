"""The terminal application: Console, Execute, Reference and Diagnose."""
