"""Measurements of the loops on this machine, each beside a baseline of the same run."""
