"""Replay a recording onto the link, for viewers and recorders.

  teleop replay recordings/demo-20260102T030405Z.mcap --view web
  teleop replay FILE                                 without a view; in another terminal:
  teleop view --session demo-replay
  teleop replay FILE --speed 0.1 --loop              in slow motion, repeated

A replay is a separate session, `<session>-replay`, in which it has the roles of master and slave.
So it starts only without either, and neither can join: no recorded command reaches a rig, and no
recorded force a hand.
"""

import argparse
import contextlib
import itertools
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from teleop.config.loading import ConfigDocument
from teleop.config.options import ViewMode, add_options
from teleop.errors import TeleopError, UsageError
from teleop.link import Link
from teleop.messages.messages import LAYOUT
from teleop.messages.topics import HAND, TOPICS, Role, Topic
from teleop.recording.reader import RecordedMessage, RecordingInfo, open_recording, read_messages
from teleop.recording.scan import RecordingError
from teleop.runtime.child_process import start_module
from teleop.runtime.clock import now_ns
from teleop.runtime.process import StopCondition, print_warning
from teleop.runtime.scratch_folder import ScratchFolder
from teleop.runtime.status_line import StatusLine
from teleop.session import own_endpoints
from teleop.session.config import RunConfig
from teleop.session.running_sessions import register_session
from teleop.view.config import ViewConfig

# --- rewrite recorded messages to come from another sender

_TOPICS = {topic.name: topic for topic in TOPICS}


class AddressedMessage(NamedTuple):
    """A message ready to be sent by the link of `role`."""

    role: Role
    topic: Topic[Any]
    data: bytes


class SenderRewriter:
    """Rewrites recorded messages so that they come from present senders.

    Listeners accept a present sender and rising numbers. So sender, sequence and checksum are
    rewritten; gaps in the recording are kept. The stamp is shifted if requested; everything else is
    unchanged.

    `nonces` are the new senders of the master's and the slave's messages; those of other processes
    get the slave's.
    """

    def __init__(self, nonces: Mapping[Role, int]) -> None:
        self._nonces = nonces
        self._sent: dict[tuple[Role, str], int] = {}  # last number of each topic
        self._seen: dict[tuple[str, int], int] = {}  # newest number recorded, by topic and sender

    def __call__(self, recorded: RecordedMessage, shift_ns: int = 0) -> AddressedMessage:
        """Return `recorded` under its new address, its stamp moved by `shift_ns`."""
        topic = _TOPICS[recorded.topic]
        schema = topic.message.schema
        head = schema.check(recorded.data)
        content = bytearray(recorded.data)
        row = np.frombuffer(content, schema.dtype)
        role = topic.publisher
        if role is None:
            role = Role.MASTER if row["role"][0] == Role.MASTER else Role.SLAVE
        last_sequence = self._seen.get((topic.name, head.sender), head.sequence)
        self._seen[topic.name, head.sender] = head.sequence
        sequence = self._sent.get((role, topic.name), 0) + max(1, head.sequence - last_sequence)
        self._sent[role, topic.name] = sequence
        row["sender"], row["sequence"] = self._nonces[role], sequence
        row["stamp_ns"] = head.stamp_ns + shift_ns
        checked_from = schema.dtype.fields["layout"][1]
        row["checksum"] = schema.compute_checksum(memoryview(content)[checked_from:])
        return AddressedMessage(role, topic, bytes(content))


_POLL_S = 0.05  # [s] between checks of stop, presence and progress
_VIEW_TIMEOUT_S = 60.0  # [s] for the view to start
_PASS_GAP_NS = 1_000_000  # [ns] between the last message of a pass and the first of the next


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop replay`."""
    parser.add_argument("file", type=Path, metavar="FILE", help="the recording (.mcap)")
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        metavar="X",
        help="speed relative to the recorded one (1)",
    )
    parser.add_argument("--loop", action="store_true", help="repeat until Ctrl-C")
    parser.add_argument(
        "--session", metavar="NAME", help="replay as session NAME (<recorded session>-replay)"
    )
    add_options(parser, "--config", "--set", "--insecure", "--view")


def main(args: argparse.Namespace) -> int:
    """Play a recording; returns the exit code."""
    if not 0.001 <= args.speed <= 1000:
        raise UsageError(f"--speed {args.speed:g}: allowed are 0.001 to 1000")
    info = open_recording(args.file)
    require_present_layout(info)
    adopt_config(args, args.file)
    document = ConfigDocument.read(args.config, args.overrides)
    session = args.session or f"{info.session or document.load(RunConfig).session}-replay"
    document = own_endpoints.choose_place(document, session)
    run = document.load(RunConfig)
    stop, status = StopCondition(), StatusLine()
    with ExitStack() as stack:
        links = {
            role: stack.enter_context(Link(run.link, session, role))
            for role in (Role.SLAVE, Role.MASTER)
        }
        stack.enter_context(register_session(own_endpoints.build_entry(run, None, args.config)))
        mode = ""
        if args.view in (None, "none"):
            mode = f"; see it with: teleop view --session {session}"
        else:
            scratch = Path(stack.enter_context(ScratchFolder()))
            snapshot = document.save_snapshot(scratch / "session")
            view = stack.enter_context(open_view(args.view, snapshot))
            wait_for_view(view, links[Role.MASTER])
        status.say(f"playing {info.seconds:.1f} s as session {session!r}{mode}")
        print_doubts(info)
        player = Player(info, args.speed, links)
        stack.callback(status.clear)
        for number in itertools.count() if args.loop else (0,):
            if not player.play(number, stop, status.show):
                break
        status.clear()
        if args.view in ("native", "web") and not stop():
            status.say("played to the end; Ctrl-C ends the view")
            while not stop() and view.poll() is None:
                time.sleep(_POLL_S)
    print(f"played {player.messages} messages")
    return 0


@contextlib.contextmanager
def open_view(view: ViewMode | Path, config: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Show the replay with `teleop view` while this context lasts."""
    words = ("--view", str(view), "--config", str(config))
    process = start_module("teleop", "view", *words, gets_interrupts=True, stdin=None)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


def wait_for_view(process: "subprocess.Popen[bytes]", link: Link) -> None:
    """Wait until the view listens to the master; `TeleopError` if it ends or takes too long."""
    end = time.monotonic() + _VIEW_TIMEOUT_S
    while not link.has_listener(HAND):  # for listeners only
        if process.poll() is not None:
            raise TeleopError(f"the view ended with exit code {process.returncode}")
        if time.monotonic() > end:
            raise TeleopError(f"the view did not start within {_VIEW_TIMEOUT_S:g} s")
        time.sleep(_POLL_S)


class Player:
    """Sends the messages of a recording at the times they were received, on an absolute grid.

    `speed` is relative to the recorded one; `links` are in the roles of master and slave.
    """

    def __init__(self, info: RecordingInfo, speed: float, links: Mapping[Role, Link]) -> None:
        self.messages = 0  # sent so far
        self._info, self._speed, self._links = info, speed, links
        self._readdress = SenderRewriter({role: link.nonce for role, link in links.items()})
        self._start_ns = now_ns()
        self._look_ns = 0

    def play(self, number: int, stop: Callable[[], bool], show: Callable[[str], None]) -> bool:
        """Play pass `number`, counted from 0; return whether it reached the end.

        The stamps continue those of the last pass, so time never decreases.
        """
        info = self._info
        shift_ns = number * (info.last_ns - info.first_ns + _PASS_GAP_NS)
        for recorded in read_messages(info.path):
            elapsed_ns = recorded.log_time_ns - info.first_ns
            due_ns = self._start_ns + round((elapsed_ns + shift_ns) / self._speed)
            while not stop() and (wait_ns := due_ns - now_ns()) > 0:
                time.sleep(min(wait_ns * 1e-9, _POLL_S))
            if stop():
                return False
            self._look(due_ns, elapsed_ns * 1e-9, number, show)
            role, topic, data = self._readdress(recorded, shift_ns)
            self._links[role].publish_raw(topic, data)
            self.messages += 1
        return True

    def _look(self, due_ns: int, at_s: float, number: int, show: Callable[[str], None]) -> None:
        """Check for role conflicts and show the progress, at intervals."""
        now = now_ns()
        if now < self._look_ns:
            return
        self._look_ns = now + round(_POLL_S * 1e9)
        for link in self._links.values():
            link.check_peers()
        late_s = (now - due_ns) * 1e-9
        pass_text = f", pass {number + 1}" if number else ""
        late_text = f", {late_s:.1f} s late" if late_s > _POLL_S else ""
        show(f"{at_s:.1f} of {self._info.seconds:.1f} s{pass_text}{late_text}")


def adopt_config(args: argparse.Namespace, file: Path) -> None:
    """Take the config of a recording, unless the command line names one, or it cannot be read."""
    if args.config is not None:
        return
    try:
        document = ConfigDocument.read(file)
        document.load(RunConfig)
        document.load(ViewConfig, "view")
    except RecordingError:
        return  # who opens it says so
    except UsageError as error:  # of another version
        print_warning(f"{error}; without the recording's config")
    else:
        args.config = file


def print_doubts(info: RecordingInfo) -> None:
    """Print what a recording lacks, one line each."""
    for line in info.doubts:
        print_warning(line)


def require_present_layout(info: RecordingInfo) -> None:
    """Raise `RecordingError` unless the recording has the present message layout."""
    if not info.messages:
        raise RecordingError(f"{info.path}: has no messages")
    if info.layout != LAYOUT:
        made_by = info.versions.get("tendon-teleop", "unknown")
        raise RecordingError(
            f"{info.path}: has another message layout than this version (made by tendon-teleop "
            f"{made_by}), so viewers would refuse it; teleop.recording.reader still reads it"
        )
