"""Ways for neighbour messages to travel, all behind one protocol class."""
