"""A session: its states, config, summary, and what both loops' processes share."""
