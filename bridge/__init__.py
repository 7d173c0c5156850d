"""From an assignment to an autopilot, over MAVLink."""
