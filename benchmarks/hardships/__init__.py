"""What `benchmarks/endurance.py` puts a target through, one file each.

A hardship is a generator ``rounds(place, tally)`` that yields after each round: it does something
that wears, counts what it did (`Tally.count`), and notes what did not hold (`Tally.expect`). It
goes on for as long as it is asked to, and clears up when closed.
"""
