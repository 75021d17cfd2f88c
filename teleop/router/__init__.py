"""A router: where the processes of many sessions meet."""
