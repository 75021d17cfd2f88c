"""Drivers of real hardware: each a codec and the exchange on its bus, in a process of its own."""
