"""Diagnosis of a user's own black-box simulator, which can only be called."""
