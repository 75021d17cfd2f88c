"""Start and supervise a whole session."""
