"""The physics of the simulated rig: tendons as chains, motors, joints, what they meet, sensors."""
