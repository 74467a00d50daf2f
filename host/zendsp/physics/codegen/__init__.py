"""Models and found effects as C."""
