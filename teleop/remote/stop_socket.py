"""Emergency stops from the same machine, past the network, which strangers can keep busy.

Each side of a session, and each `teleop stop --watch`, has a Unix datagram socket in the user's
runtime folder, which nobody else can enter:

    <runtime folder>/<session>.<network namespace>.<role>.<random>.stop

A request is a line of text, `stop` or `reset NUMBER`, and after it the reason, in any bytes. The
answer has a line `ROLE STATE STOPS` for the process itself, and a line `ROLE STATE` for each side
that it is connected to, with the state `silent` if nothing comes from that side. Neither depends on
the version of the messages. The module imports nothing that is slow to import, since an emergency
stop does not wait.
"""

import os
import re
import select
import socket
import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import NamedTuple, Self

from teleop.session.running_sessions import find_usable_folders, list_own_folders

ANSWER_S = 2.0  # [s] timeout for the answers of all processes; they take milliseconds
REPEAT_S = 0.02  # [s] between two requests: a peer's state in an answer may still be the old one
REQUEST_BYTES = 1024
REQUESTS = 4  # taken at a time; the others wait for the next tick
SIDES = ("master", "slave")
STOPPED, SILENT, ENDED = "stopped", "silent", "ended"
_REQUEST = re.compile(rb"(?P<action>stop|reset) ?(?P<number>\d{1,9})?(?:\n(?P<reason>.*))?", re.S)
_ANSWER = re.compile(r"(?P<role>[a-z]{1,9}) (?P<state>[a-z]{1,9})(?: (?P<stops>\d{1,9}))?")


class LocalRequest(NamedTuple):
    """A request from this machine."""

    is_reset: bool
    number: int  # of the stop that is to be reset
    reason: str


class StopSocket:
    """Receives requests of this user; a context manager, used from one thread.

    `role` is that of this process, in lower case; `warning` says, once entered, why there is no
    socket, empty if there is one.
    """

    def __init__(self, session: str, role: str) -> None:
        # no process number: in a restarted container a killed process had the same one
        self._name = f"{session}.{_read_network_namespace()}.{role}.{os.urandom(4).hex()}.stop"
        self.warning = ""
        self._socket: socket.socket | None = None
        self._poll = select.poll()
        self._askers: set[str] = set()  # without an answer so far
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        reason = "there is no folder of this user alone: set XDG_RUNTIME_DIR"
        for folder in find_usable_folders(self._name):
            try:
                self._socket = _bind_socket(folder / self._name, self._stack)
            except OSError as error:
                reason = str(error)
            else:
                self._poll.register(self._socket, select.POLLIN)
                return self
        self.warning = (
            "WARNING: `teleop stop` reaches this process over the network only: no socket in the "
            f"runtime folder of this user: {reason}"
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._socket = None
        self._stack.close()

    @property
    def is_asked(self) -> bool:
        """Whether a request waits for an answer."""
        return bool(self._askers)

    def fileno(self) -> int:
        """Return the file number to wait for requests at; -1 if there is no socket."""
        return -1 if self._socket is None else self._socket.fileno()

    def take(self) -> list[LocalRequest]:
        """Return the requests that wait, without waiting; takes a microsecond if there are none."""
        requests: list[LocalRequest] = []
        while self._socket is not None and len(requests) < REQUESTS and self._poll.poll(0):
            try:
                data, asker = self._socket.recvfrom(REQUEST_BYTES)
            except OSError:
                break
            match = _REQUEST.fullmatch(data)
            if match is None:
                continue
            if asker:
                self._askers.add(asker)
            requests.append(
                LocalRequest(
                    match["action"] == b"reset",
                    int(match["number"] or 0),
                    (match["reason"] or b"").decode(errors="replace"),
                )
            )
        return requests

    def answer(self, lines: list[str]) -> None:
        """Answer all who have asked since the last answer."""
        askers, self._askers = self._askers, set()
        for asker in askers:
            if self._socket is not None:
                with suppress(OSError):  # it waits no more
                    self._socket.sendto("\n".join(lines).encode(), asker)


class LocalAnswers:
    """What the processes of a session on this machine have answered.

    `roles` are those of the processes that were asked; `stops` has the number of the newest stop of
    each side that answered for itself.
    """

    def __init__(self, roles: set[str]) -> None:
        self._own = dict.fromkeys(roles & set(SIDES), SILENT)
        self._reported: dict[str, str] = {}
        self.stops: dict[str, int] = {}

    @property
    def states(self) -> dict[str, str]:
        """State of each side in lower case, by role.

        `SILENT` if it was asked and did not answer, `ENDED` if it ended in order instead.
        """
        merged = self._reported | self._own
        return {side: merged[side] for side in SIDES if side in merged}

    @property
    def has_silent_peer(self) -> bool:
        """Whether a side elsewhere is connected to a side here and sends nothing to it."""
        return any(self._reported[side] == SILENT for side in self._reported.keys() - self._own)

    @property
    def are_direct(self) -> bool:
        """Whether each side has answered for itself."""
        return bool(self._own) and self._reported.keys() <= self._own.keys()

    def are_complete(self, is_reset: bool) -> bool:
        """Return whether all have obeyed but those that nothing will come from."""
        awaited = self._own if self.has_silent_peer else self.states
        states = awaited.values()
        return bool(states) and all(
            s == ENDED or (s != SILENT and (s == STOPPED) != is_reset) for s in states
        )

    def note_end(self, role: str) -> None:
        """Note that a process that was asked has ended, and left its actuators safe."""
        if role in self._own:
            self._own[role] = ENDED

    def add(self, data: bytes) -> None:
        """Take an answer."""
        for line in data.decode(errors="replace").splitlines():
            match = _ANSWER.fullmatch(line)
            if match is None or match["role"] not in SIDES:
                continue
            if match["stops"] is None:
                if self._reported.get(match["role"]) != SILENT:  # then the network is asked
                    self._reported[match["role"]] = match["state"]
            else:
                self._own[match["role"]] = match["state"]
                self.stops.setdefault(match["role"], int(match["stops"]))


def request_local(session: str, is_reset: bool, reason: str) -> LocalAnswers:
    """Send a stop, or a reset, to the processes of a session on this machine until all obey.

    A reset resets the stop that its side has when it answers first, not a later one. Gives up after
    `ANSWER_S`; then some of the states are others. A side elsewhere that is silent is not waited
    for: the network is the only way to it. Without a socket for the answers the request is sent
    once, and the sides here stay `SILENT`.
    """
    with ExitStack() as stack:
        sockets = [(path, role) for path, name, role in _list_sockets() if name == session]
        answers = LocalAnswers({role for _, role in sockets})
        if not sockets:
            return answers
        folders = [path.parent for path, _ in sockets]
        mine, has_address = _open_sender(list(dict.fromkeys(folders + list_own_folders())), stack)
        deadline = time.monotonic() + ANSWER_S
        while sockets and time.monotonic() < deadline:
            for address, role in list(sockets):
                action = f"reset {answers.stops.get(role, 0)}" if is_reset else "stop"
                try:
                    mine.sendto(action.encode() + b"\n" + as_bytes(reason), str(address))
                except FileNotFoundError:  # its process has ended in order, and removed it
                    sockets.remove((address, role))
                    answers.note_end(role)
                except ConnectionRefusedError:  # its process was killed
                    with suppress(OSError):
                        address.unlink()
                    sockets.remove((address, role))
                except OSError:  # its queue is full: it gets the next one
                    continue
                if not has_address:
                    sockets.remove((address, role))
            ready = time.monotonic() + REPEAT_S
            while select.select([mine], [], [], max(0.0, ready - time.monotonic()))[0]:
                answers.add(mine.recv(REQUEST_BYTES))
            if answers.are_complete(is_reset):
                break
        return answers


def list_sessions_with_sockets() -> set[str]:
    """Return the names of this user's sessions with a socket on this machine."""
    return {session for _, session, _ in _list_sockets()}


def as_bytes(reason: str) -> bytes:
    """Return a reason as bytes, whatever is in it, short enough for a request."""
    return reason.encode(errors="replace")[: REQUEST_BYTES // 2]


def _list_sockets() -> list[tuple[Path, str, str]]:
    """Return the sockets on this machine, with session and role of each.

    Those of killed processes are removed.
    """
    sockets = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
        for path in (path for folder in list_own_folders() for path in folder.glob("*.stop")):
            session, network, role, *_ = (*path.name.split("."), "", "")
            if network != str(_read_network_namespace()):
                continue
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                with suppress(OSError):
                    path.unlink()
            except OSError:  # it is gone
                continue
            else:
                sockets.append((path, session, role))
    return sockets


def _open_sender(folders: list[Path], stack: ExitStack) -> tuple[socket.socket, bool]:
    """Return a socket for requests, and whether it can be answered: it needs a file for that."""
    for folder in folders:
        with suppress(OSError):  # read-only, or no space for a file
            return _bind_socket(folder / f"{os.urandom(8).hex()}.answer", stack), True
    unbound = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
    unbound.setblocking(False)
    return unbound, False


def _bind_socket(path: Path, stack: ExitStack) -> socket.socket:
    """Return a datagram socket at `path`, for its owner only; `stack` closes and removes it."""
    bound = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
    bound.bind(str(path))
    stack.callback(path.unlink, missing_ok=True)
    path.chmod(0o600)
    bound.setblocking(False)
    return bound


def _read_network_namespace() -> int:
    """Return the number of this network namespace: a container is a machine of its own."""
    try:
        return os.stat("/proc/self/ns/net").st_ino
    except OSError:
        return 0
