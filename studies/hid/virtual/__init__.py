"""What the firmware of a HID device does, bytes in and bytes out; see `device` for the protocol.

The offsets here are written by hand from what is known of each firmware, and none of it goes
through `master.devices.hid`: the drivers are tested against this, so it must not share their
mistakes. Nothing here has a clock; time [s] is an argument, of any origin, never decreasing.
"""
