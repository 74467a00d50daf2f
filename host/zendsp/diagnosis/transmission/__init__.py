"""What two sensors on the two sides of a transmission, or a torque sensor in it, show of it."""
