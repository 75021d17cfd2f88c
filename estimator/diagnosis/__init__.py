"""What a model of a dataset gets wrong, why, and the gain of correcting it: `engine.diagnose`."""
