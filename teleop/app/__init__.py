"""The command line, the launcher of sessions and the doctor."""
