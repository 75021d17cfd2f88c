"""`teleop config`: a config with the source of each value, and the page of all keys."""
