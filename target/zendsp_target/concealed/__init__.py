"""What a simulated machine conceals, sealed until it is revealed."""
