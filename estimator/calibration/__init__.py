"""A sheath's parameters from measured loops."""
