"""The simulated rig and its plant, which shares no equation with the estimator."""
