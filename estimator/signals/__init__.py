"""Signals of a measured record: when they were sampled, their noise, spikes, and the drive."""
