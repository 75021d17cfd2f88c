"""Why an endpoint that answers does not become a connection.

Zenoh keeps to itself why a handshake of TLS failed, so without this a side with keys of another
authority, or in plaintext beside a secure one, would wait for ever without a word.
"""

import socket
import ssl
import threading
from collections.abc import Callable, Iterable

import zenoh
from cryptography import x509

from teleop.link.config import Address
from teleop.security import CertificateError, Credentials

PROBE_PERIOD_S = 5.0
PROBE_TIMEOUT_S = 1.0  # for a connection, and for an answer


class ConnectionProbe:
    """Looks, in a thread of its own, at endpoints that are not connected; as a context manager.

    Parameters
    ----------
    endpoints : iterable of str
        `HOST:PORT` that Zenoh connects to.
    credentials : Credentials, optional
        Ours; None in an insecure session.
    session : str
        Our session.
    connected : callable
        Returns the far ends of the connections, `PROTOCOL/HOST:PORT`.
    note : callable
        Told what is wrong with an endpoint, when that changes.
    """

    def __init__(
        self,
        endpoints: Iterable[str],
        credentials: Credentials | None,
        session: str,
        connected: Callable[[], Iterable[str]],
        note: Callable[[str], None],
    ) -> None:
        self._found = dict.fromkeys(endpoints, "")
        self._credentials, self._session = credentials, session
        self._connected, self._note = connected, note
        self._end = threading.Event()

    def __enter__(self) -> "ConnectionProbe":
        if self._found:
            threading.Thread(target=self._work, name="connection probe", daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()

    def _work(self) -> None:
        while not self._end.wait(PROBE_PERIOD_S):
            try:
                connected = {end.rpartition("/")[2] for end in self._connected()}
            except zenoh.ZError:  # closed
                return
            for endpoint in self._found.keys() - connected:
                why = find_connection_fault(endpoint, self._credentials, self._session)
                if why and why != self._found[endpoint] and not self._end.is_set():
                    self._note(f"a connection to {endpoint}: {why}")
                self._found[endpoint] = why


def find_connection_fault(endpoint: str, credentials: Credentials | None, session: str) -> str:
    """Return why whoever listens at `endpoint` is not connected to; empty if unknown or nobody."""
    try:
        certificate = fetch_certificate(endpoint)
    except ValueError:
        return "its certificate cannot be read"
    except OSError:
        return ""
    if credentials is None:
        return "" if certificate is None else "it is secure, and this side is not (link.insecure)"
    if certificate is None:
        return "no answer in TLS: another program, a hanging one, or a side with link.insecure"
    try:
        identity = credentials.identify(certificate)
    except CertificateError as error:
        return str(error)
    return "" if identity.may_join(session) else f"its certificate is {identity.common_name}"


def fetch_certificate(endpoint: str) -> x509.Certificate | None:
    """Return the certificate of whoever listens at `HOST:PORT`; None if it speaks no TLS.

    Raises
    ------
    OSError
        Nobody listens, or answers.
    ValueError
        The certificate cannot be read.
    """
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE  # it is only looked at; nothing is sent
    address = Address.parse(endpoint)
    with socket.create_connection(address, PROBE_TIMEOUT_S) as plain:
        try:
            with context.wrap_socket(plain) as secured:
                der = secured.getpeercert(binary_form=True)
        except (ssl.SSLError, ConnectionError, TimeoutError):
            return None
    return x509.load_der_x509_certificate(der) if der else None
