"""The lumped model: a chain of nodes that takes any effect."""
