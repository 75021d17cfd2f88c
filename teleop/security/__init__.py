"""Keys and certificates: who may take part in a session, and as what.

A process proves its role by a certificate of an authority that all processes of a session trust.
"""

from teleop.security.certificates import CertificateError, NotYetValidError
from teleop.security.credentials import Credentials
from teleop.security.identity import CERTIFICATE_ROLES, RIGHTS, CertificateRole, Identity

__all__ = [
    "CERTIFICATE_ROLES",
    "RIGHTS",
    "CertificateError",
    "CertificateRole",
    "Credentials",
    "Identity",
    "NotYetValidError",
]
