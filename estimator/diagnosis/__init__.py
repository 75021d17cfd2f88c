"""What a model of a bench gets wrong, why, and what mending it is worth: `engine.diagnose`."""
