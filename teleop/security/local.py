"""Credentials without asking, for sessions on one machine.

Each user has an authority of his own, below `$XDG_STATE_HOME/teleop/keys` (default
`~/.local/state`), which he alone can read. Every process issues itself a certificate that lasts for
`LOCAL_DAYS` and is kept in memory only. So all processes of one user find together, and another
user of the machine gets nowhere.
"""

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from teleop.errors import UsageError
from teleop.runtime.files import find_state_folder
from teleop.security.authority import AUTHORITY, Authority
from teleop.security.credentials import Credentials
from teleop.security.identity import RIGHTS, CertificateRole, Identity

LOCAL_DAYS = 7  # longer than any session
AUTHORITY_LIFE_DAYS = 365  # [days]
_EPOCH = datetime(2000, 1, 1, tzinfo=UTC)  # on one machine a clock set back must not matter


def find_local_folder() -> Path:
    """Return the folder of this user's authority."""
    return find_state_folder() / "teleop" / "keys"


def create_local_credentials(session: str, office: CertificateRole) -> Credentials:
    """Return new credentials of a role in a session; `UsageError` if they cannot be kept."""
    authority = _obtain_authority()
    identity = Identity(office, session, RIGHTS if office is CertificateRole.SUPERVISOR else ())
    certificate, key = authority.issue(identity, LOCAL_DAYS, _EPOCH)
    return Credentials(
        identity, certificate, key, authority.certificate, authority.revoked, lasting=False,
        folder=find_local_folder(),
    )  # fmt: skip


def _obtain_authority() -> Authority:
    """Return this user's authority, made if there is none that lasts."""
    folder = find_local_folder()
    try:
        return _load_valid_authority(folder) or _make_authority(folder)
    except OSError as error:
        raise UsageError(
            f"{folder}: no keys can be kept here: {error.strerror}; set XDG_STATE_HOME to a folder "
            "of yours, or link.keys"
        ) from error


def _load_valid_authority(folder: Path) -> Authority | None:
    """Return the authority of a folder; None if there is none, or it expires soon."""
    if not (folder / AUTHORITY).is_file():
        return None
    _require_private_folder(folder)
    authority = Authority.load(folder)
    left = authority.certificate.not_valid_after_utc - datetime.now(UTC)
    return authority if left > timedelta(days=LOCAL_DAYS) else None


def _make_authority(folder: Path) -> Authority:
    """Make the authority; of several processes at once the first one wins."""
    folder.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    with _lock_folder(folder.parent):
        if (authority := _load_valid_authority(folder)) is not None:  # another process was faster
            return authority
        # a new name, which nobody can have taken before
        draft = Path(tempfile.mkdtemp(prefix=".keys-", dir=folder.parent))
        Authority.create("teleop on this machine", AUTHORITY_LIFE_DAYS, _EPOCH).save(draft / "new")
        if folder.exists():
            folder.rename(draft / "old")
        (draft / "new").rename(folder)
        shutil.rmtree(draft)
        _require_private_folder(folder)
        return Authority.load(folder)


@contextlib.contextmanager
def _lock_folder(folder: Path) -> Iterator[None]:
    """Let one process at a time make an authority in `folder`."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _require_private_folder(folder: Path) -> None:
    status = folder.stat()
    if status.st_uid != os.geteuid() or status.st_mode & 0o077:
        raise UsageError(f"{folder}: must belong to this user alone; chmod 700 {folder}")
