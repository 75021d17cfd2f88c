"""The family of errors a user can cause or meet.

The command line prints one as a single line and ends with its exit code; anything outside this
family is a defect of ours and shows its traceback.
"""


class TeleopError(Exception):
    """A fault that ends the session: exit code 1, one line."""

    exit_code = 1


class UsageError(TeleopError):
    """Wrong usage, config or data: exit code 2, one line that names place and remedy."""

    exit_code = 2


class PeerError(UsageError):
    """A peer that must not be talked to: a second master, or another message version."""
