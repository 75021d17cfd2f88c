"""Sessions in files: written while they run, read afterwards, played back onto the link."""
