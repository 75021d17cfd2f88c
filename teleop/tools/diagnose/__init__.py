"""`teleop diagnose`: what is wrong with a model of measured data, said to people and programs."""
