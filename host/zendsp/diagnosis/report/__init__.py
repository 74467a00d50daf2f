"""The report of a diagnosis: its page, figures and files."""
