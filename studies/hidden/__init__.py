"""Effects hidden in data of an independent chain, diagnosed and counted."""
