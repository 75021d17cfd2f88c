"""Ground truth by brute force: slow, simple, and sharing nothing with the estimator."""
