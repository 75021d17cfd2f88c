"""The transmission as mathematics: tension law, calibration, online estimator. No clock, no I/O."""
