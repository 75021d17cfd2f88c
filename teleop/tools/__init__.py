"""Commands that work on data and benches, offline: none of them runs in a session."""
