"""Bring up a rig of real hardware: what is on the bus, what it measures, which way it moves."""
