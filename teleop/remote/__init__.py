"""Remote requests to a running session: stop, reset, change a setting."""
