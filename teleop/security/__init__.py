"""Keys and certificates: who may take part in a session, and as what.

A process proves its role by a certificate of an authority that all processes of a session trust.
"""

from teleop.security.credentials import Credentials
from teleop.security.identity import CERTIFICATE_ROLES, RIGHTS, CertificateRole, Identity
from teleop.security.key_files import CertificateError, NotYetValidError

__all__ = [
    "CERTIFICATE_ROLES",
    "RIGHTS",
    "CertificateError",
    "CertificateRole",
    "Credentials",
    "Identity",
    "NotYetValidError",
]
