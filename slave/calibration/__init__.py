"""The initialisation procedure: move each joint to its stops, and calibrate its sheaths there."""
