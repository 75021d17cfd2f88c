"""The plant of the simulated rig: tendons, motors, joints, environments, sensors, effects.

It shares no equation with the estimator.
"""
