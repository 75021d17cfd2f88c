"""The physics of the simulated rig: the tendon as a chain, its motor, its tip, its sensors."""
