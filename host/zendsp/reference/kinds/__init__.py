"""One generator per file; ``zendsp.reference.registry`` lists them."""
