"""Strangers without a certificate, who keep the ports of a session busy."""

import socket
import ssl
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress

SILENT = 300  # connections that say nothing, at each port
FAILING_HZ = 20.0  # attempts at TLS without a certificate, at each port


@contextmanager
def flooded(endpoints: Iterable[str]) -> Iterator[None]:
    """Flood `HOST:PORT`s: more than Zenoh drains."""
    end = threading.Event()
    addresses = [(host, int(port)) for host, _, port in (e.rpartition(":") for e in endpoints)]

    def fail(address: tuple[str, int]) -> None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
        while not end.wait(1.0 / FAILING_HZ):
            with (
                suppress(OSError),
                socket.create_connection(address, 0.2) as plain,
                context.wrap_socket(plain) as secured,
            ):
                secured.recv(1)

    with ExitStack() as stack:
        for address in addresses:
            for _ in range(SILENT):
                silent = stack.enter_context(socket.socket())
                silent.setblocking(False)
                silent.connect_ex(address)
        threads = [threading.Thread(target=fail, args=(a,)) for a in addresses]
        for thread in threads:
            thread.start()
        try:
            time.sleep(2.0)  # until Zenoh is busy
            yield
        finally:
            end.set()
            for thread in threads:
                thread.join()
