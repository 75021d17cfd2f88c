"""The credentials that the config of a link asks for."""

from teleop.keys import Credentials, Office
from teleop.keys import credentials as stored
from teleop.keys.local import local_credentials
from teleop.link.config import LinkConfig


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
