"""A serial line with a model at its far end."""

import errno
import fcntl
import os
import select
import termios
import threading
import time
import tty
from pathlib import Path


class BusThread:
    """A model that `serve`s a bus in a thread of its own, until `ended` is set."""

    ended = False

    def start(self) -> threading.Thread:
        thread = threading.Thread(target=self.serve, daemon=True)
        thread.start()
        return thread


class PseudoPort:
    """The far end of a pty; `name` is the device that a driver opens.

    Closing it is what unplugging an adapter is to the driver. With a `link`, that is its name, and
    stays the same when it is plugged in again.
    """

    def __init__(self, link: Path | None = None) -> None:
        self.wanted = True  # to be plugged in; obeyed at the next `read`
        self._link = link
        self._plug()

    def _plug(self) -> None:
        self._far, self._near = os.openpty()
        tty.setraw(self._near)
        tty.setraw(self._far)
        os.set_blocking(self._far, False)
        self.name = os.ttyname(self._near)
        self._plugged = True
        if self._link is not None:
            self._link.unlink(missing_ok=True)
            self._link.symlink_to(self.name)
            self.name = str(self._link)

    def read(self, wait_s: float = 0.0) -> bytes:
        """Return what has arrived, after at most `wait_s` [s]."""
        if self.wanted and not self._plugged:
            self._plug()
        elif self._plugged and not self.wanted:
            self.unplug()
        if not self._plugged:
            time.sleep(wait_s)
            return b""
        # the last close of a real port ends its exclusive mode; here the near end stays open
        fcntl.ioctl(self._near, termios.TIOCNXCL)
        try:
            if wait_s > 0.0:
                select.select([self._far], [], [], wait_s)
            return os.read(self._far, 4096)
        except BlockingIOError:
            return b""
        except OSError as error:
            if error.errno in (errno.EIO, errno.EBADF):
                return b""
            raise

    def write(self, data: bytes) -> None:
        """Send; what finds no room is lost, as nobody reads it."""
        if not self._plugged:
            return
        try:
            os.write(self._far, data)
        except BlockingIOError:
            termios.tcflush(self._near, termios.TCIFLUSH)

    def unplug(self) -> None:
        """Hang up, once; call it from the thread that reads and writes."""
        if not self._plugged:
            return
        self._plugged = self.wanted = False
        if self._link is not None:
            self._link.unlink(missing_ok=True)
        for end in (self._far, self._near):
            os.close(end)
