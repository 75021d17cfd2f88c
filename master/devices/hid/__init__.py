"""Haptic devices that speak HID: their bytes, and the one handle that carries them."""
