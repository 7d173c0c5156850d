"""One file an autopilot family, the same members in each."""
