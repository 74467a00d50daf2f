"""What two sensors on the two sides of a transmission show of it."""
