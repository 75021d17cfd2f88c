"""The operator's side: haptic devices, force feedback, the master loop."""
