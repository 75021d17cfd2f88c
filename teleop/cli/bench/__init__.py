"""Benchmarks of the loops on this machine, each with a baseline in the same run."""
