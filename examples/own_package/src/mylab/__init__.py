"""A laboratory's own rig, device and effect."""
