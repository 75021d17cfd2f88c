"""What a model of a dataset gets wrong, why, and what mending it is worth: `engine.diagnose`."""
