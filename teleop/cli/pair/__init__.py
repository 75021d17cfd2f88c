"""Friction of an antagonistic pair of tendons against the bend of its sheath."""
