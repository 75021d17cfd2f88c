"""Credentials without asking, for sessions on one machine.

Each user has an authority of his own, below `$XDG_STATE_HOME/teleop/keys` (default
`~/.local/state`), which he alone can read. Every process issues itself a certificate that lasts for
`LOCAL_DAYS` and is kept in memory only. So all processes of one user find together, and another
user of the machine gets nowhere.
"""

import os
from datetime import UTC, datetime, timedelta
from pathlib import Path

from teleop.errors import UsageError
from teleop.keys.authority import AUTHORITY, Authority
from teleop.keys.credentials import Credentials
from teleop.keys.identity import RIGHTS, Identity, Office

LOCAL_DAYS = 7  # longer than any session
AUTHORITY_LIFE = 365  # [days]
_EPOCH = datetime(2000, 1, 1, tzinfo=UTC)  # on one machine a clock set back must not matter


def local_folder() -> Path:
    """Return the folder of this user's authority."""
    state = os.environ.get("XDG_STATE_HOME") or str(Path.home() / ".local" / "state")
    return Path(state) / "teleop" / "keys"


def local_credentials(session: str, office: Office) -> Credentials:
    """Return new credentials of a role in a session; `UsageError` if they cannot be kept."""
    authority = _authority()
    identity = Identity(office, session, RIGHTS if office is Office.SUPERVISOR else ())
    certificate, key = authority.issue(identity, LOCAL_DAYS, _EPOCH)
    return Credentials(
        identity, certificate, key, authority.certificate, authority.revoked, lasting=False
    )


def _authority() -> Authority:
    """Return this user's authority, made if there is none that lasts."""
    folder = local_folder()
    try:
        if (folder / AUTHORITY).is_file():
            _require_private(folder)
            authority = Authority.load(folder)
            left = authority.certificate.not_valid_after_utc - datetime.now(UTC)
            if left > timedelta(days=LOCAL_DAYS):
                return authority
        return _make(folder)
    except OSError as error:
        raise UsageError(
            f"{folder}: no keys can be kept here: {error.strerror}; set XDG_STATE_HOME to a folder "
            "of yours, or link.keys"
        ) from error


def _make(folder: Path) -> Authority:
    """Make the authority; of several processes at once the first one wins."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    draft = folder.with_name(f".keys-{os.getpid()}")
    Authority.create("teleop on this machine", AUTHORITY_LIFE, _EPOCH).save(draft)
    if folder.exists() and (folder / AUTHORITY).is_file():
        return _replace_expired(folder, draft)
    try:
        draft.rename(folder)
    except OSError:  # another process was faster
        _remove(draft)
    _require_private(folder)
    return Authority.load(folder)


def _replace_expired(folder: Path, draft: Path) -> Authority:
    old = folder.with_name(f".keys-{os.getpid()}-old")
    folder.rename(old)
    draft.rename(folder)
    _remove(old)
    return Authority.load(folder)


def _remove(folder: Path) -> None:
    for path in folder.iterdir():
        path.unlink()
    folder.rmdir()


def _require_private(folder: Path) -> None:
    status = folder.stat()
    if status.st_uid != os.geteuid() or status.st_mode & 0o077:
        raise UsageError(f"{folder}: must belong to this user alone; chmod 700 {folder}")
