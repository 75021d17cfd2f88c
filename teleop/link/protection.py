"""The credentials that the config of a link asks for."""

from teleop.link.config import LinkConfig
from teleop.security import Credentials, Office
from teleop.security import credentials as stored
from teleop.security.local import local_credentials


def credentials_of(config: LinkConfig, session: str, office: Office) -> Credentials | None:
    """Return the credentials of a role in a session; None if the config asks for plaintext.

    Raises
    ------
    UsageError
        There are none, or they are not valid.
    """
    if config.insecure:
        return None
    if config.keys is not None:
        return stored.load(config.keys, session, office)
    return local_credentials(session, office)
