"""HID haptic devices: report codecs, and the handle that transfers the reports."""
