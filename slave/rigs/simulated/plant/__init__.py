"""The physics of the simulated rig: tendon chains, motors, joints, environments, sensors."""
