"""The online estimator of one tendon: driving end, interval, corrections."""
