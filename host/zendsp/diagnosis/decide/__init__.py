"""What is claimed: mechanisms, laws, bodies, and how sure."""
