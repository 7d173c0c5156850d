"""Fleet simulator in pure Python: world, vehicles, autopilots, radio."""
