"""What other processes may ask of a running session: to stop, to go on, to change a setting."""
