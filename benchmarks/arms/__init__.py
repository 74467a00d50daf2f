"""What `benchmarks/forms.py` makes: arms, how they really move, and files that describe them."""
