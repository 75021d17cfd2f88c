"""Faults in a running session, and what recordings say of how it took them."""
