"""A microcontroller on a serial line: motors and load cells, or load cells alone."""
