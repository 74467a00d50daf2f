"""What is claimed: mechanisms, laws, bodies, how sure; the result, and what to record next."""
