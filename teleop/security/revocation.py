"""The list of revoked certificates of a running process, which follows the file."""

from collections.abc import Callable

from teleop.errors import UsageError
from teleop.security.authority import REVOKED, load_revoked
from teleop.security.credentials import Credentials


class RevocationList:
    """What is revoked, by the file in the folder of keys; read again when that changes.

    A certificate that was revoked once stays so in this process. A file that is missing, damaged or
    not signed by the authority changes nothing and is complained about, once.

    Parameters
    ----------
    credentials : Credentials
        Of this process, with the list as it was at the start.
    """

    def __init__(self, credentials: Credentials) -> None:
        self.serials = credentials.revoked
        self._credentials = credentials
        self._seen = self._state()

    def update(self, complain: Callable[[str], None]) -> bool:
        """Read the file if it has changed; return whether more certificates are revoked."""
        state, folder = self._state(), self._credentials.folder
        if state == self._seen or folder is None:
            return False
        self._seen = state
        try:
            found = load_revoked(folder, self._credentials.authority)
        except UsageError as error:
            if self._credentials.lasting:  # a local authority is replaced when it has expired
                complain(f"a list of revoked certificates: {error}; the earlier one stays in force")
            return False
        grown = not found <= self.serials
        self.serials |= found
        return grown

    def _state(self) -> tuple[int, ...]:
        """Return what changes with the file."""
        folder = self._credentials.folder
        if folder is None:
            return ()
        try:
            status = (folder / REVOKED).stat()
        except OSError:
            return (0,)
        return status.st_mtime_ns, status.st_size, status.st_ino
