"""Commands of the command line; `commands` is their table."""
