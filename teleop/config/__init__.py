"""Configs: YAML, defaults, overrides, and the errors that name file and key."""
