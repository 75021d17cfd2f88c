"""The credentials that the config of a link asks for."""

from teleop.link.config import LinkConfig
from teleop.security import CertificateRole, Credentials
from teleop.security import credentials as stored
from teleop.security.local import create_local_credentials


def load_credentials(
    config: LinkConfig, session: str, office: CertificateRole
) -> Credentials | None:
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
    return create_local_credentials(session, office)
