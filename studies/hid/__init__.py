"""HID devices as programs: their report descriptors, and what their firmware does."""
