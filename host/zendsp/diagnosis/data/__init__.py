"""Reads files and prepares joint records for the estimators."""
