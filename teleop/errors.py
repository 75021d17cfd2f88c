"""Exceptions for users.

The command line prints one as a single line and exits with its code; any other exception is a bug
and shows its traceback.
"""


class TeleopError(Exception):
    """A fault that ends the session: exit code 1, one line."""

    exit_code = 1


class UsageError(TeleopError):
    """Wrong usage, config or data: exit code 2, one line with place and remedy."""

    exit_code = 2


class PeerError(UsageError):
    """An incompatible peer: a second master, or another message version."""
