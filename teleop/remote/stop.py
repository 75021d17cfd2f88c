"""The emergency stop of a session, from any terminal that reaches its endpoints.

  teleop stop                      emergency stop: no force, motors hold, until reset
  teleop stop --config rig.yaml    for the session of this config
  teleop stop --watch              stop when this process ends, freezes or is disconnected
  teleop stop --reset              reset the stop; the operator must release and engage again

Exit code 0 when every connected side reports that it has stopped. With --watch, Enter stops at
once; `q`, then Enter, ends the watch without a stop.
"""

import argparse
import select
import sys
import time
from collections.abc import Callable
from typing import Any

from teleop.errors import TeleopError
from teleop.link import Link
from teleop.options import add_options
from teleop.process import Stop
from teleop.remote.requests import CALL, LEAVE, RESET, WATCH, call_reset, call_stop
from teleop.remote.watches import BEAT_S
from teleop.run_config import load_shared
from teleop.session import Reason, State
from teleop.topics import COMMAND, STATE, Role, Topic

PATIENCE_S = 3.0  # timeout for the answers of all sides
LEAST_S = 0.4  # time for a second side to appear, after the first
REPEAT_S = 0.02  # between two messages: the first may be lost while the link connects
SIDES: dict[Role, Topic[Any]] = {Role.MASTER: COMMAND, Role.SLAVE: STATE}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop stop`."""
    add_options(parser, "--session", "--config", "--set", "--insecure")
    way = parser.add_mutually_exclusive_group()
    way.add_argument("--reset", action="store_true", help="reset an emergency stop")
    way.add_argument("--watch", action="store_true", help="stop when this process ends")
    parser.add_argument(
        "--why", default="", metavar="TEXT", help="reason, sent and recorded with it"
    )


def main(args: argparse.Namespace) -> int:
    """Stop a session, reset the stop, or watch the session; returns the exit code."""
    config = load_shared(args)
    role = Role.WATCH if args.watch else Role.REMOTE
    stop = Stop()
    # an emergency stop does not wait for the detection of peers
    with Link(config.link, config.session, role, at_once=not args.watch) as link:
        if link.warning:
            print(link.warning, flush=True)
        if args.watch:
            return watch(link, stop, args.why)
        action = RESET if args.reset else CALL
        states = request_all(link, role, action, args.why or "teleop stop", stop)
    for side, state in states.items():
        print(f"{side.name.lower():9} {state.name.lower()}")
    obeyed = [(state is State.STOPPED) != args.reset for state in states.values()]
    if not states:
        raise TeleopError(f"session {config.session!r}: no answer from master or slave")
    if not all(obeyed):
        still = "is still stopped; its terminal shows why" if args.reset else "has NOT stopped"
        sides = [side.name.lower() for side, ok in zip(states, obeyed, strict=True) if not ok]
        raise TeleopError(f"the {' and the '.join(sides)} {still}")
    if args.reset:
        print("release the engage switch, then press it again")
    return 0


def request_all(
    link: Link, role: Role, action: int, words: str, stop: Callable[[], bool]
) -> dict[Role, State]:
    """Send the request until every connected side has executed it; return their states."""
    for topic in SIDES.values():
        link.subscribe_latest(topic)
    begin, first = time.monotonic(), 0.0
    states: dict[Role, State] = {}
    named: dict[Role, int] = {}  # number of the stop to be reset, not a later one
    while not stop():
        now = time.monotonic()
        states = {side: state_of(link, side) for side in SIDES if link.present(side)}
        if action == CALL:
            call_stop(link, role, words)
        else:
            for side in (s for s, state in states.items() if state is State.STOPPED):
                number = named.setdefault(side, stops_of(link, side))
                call_reset(link, role, words, side, number)
        first = first or (now if states else 0.0)
        done = all((state is State.STOPPED) == (action == CALL) for state in states.values())
        if (first and done and now - first > LEAST_S) or now - begin > PATIENCE_S:
            break
        time.sleep(REPEAT_S)
    return states


def state_of(link: Link, side: Role) -> State:
    """Return the reported state of a side, OFF before its first message."""
    message = link.latest(SIDES[side]).message
    return State.OFF if message is None else State(message.state)


def stops_of(link: Link, side: Role) -> int:
    """Return the reported number of stops of a side."""
    message = link.latest(SIDES[side]).message
    return 0 if message is None else int(message.stops)


def watch(link: Link, stop: Stop, words: str) -> int:
    """Send heartbeats until stopped; any other end of this process is an emergency stop."""
    deadline = time.monotonic() + PATIENCE_S
    while not all(map(link.present, SIDES)) and time.monotonic() < deadline and not stop():
        time.sleep(0.01)
    sides = [side for side in SIDES if link.present(side)]
    if not sides:
        raise TeleopError(
            f"session {link.session!r}: no master and no slave connected, nothing to watch"
        )
    names = " and ".join(side.name.lower() for side in sides)
    print(f"watching {names}; Enter stops; q, then Enter, ends the watch", flush=True)
    listening = True
    while not stop():
        call_stop(link, Role.WATCH, words, WATCH)
        line = None
        if listening and select.select([sys.stdin], [], [], BEAT_S)[0]:
            line = sys.stdin.readline()
            listening = line != ""  # no more input from a closed terminal
        elif not listening:
            time.sleep(BEAT_S)
        if line is not None and line.strip() == "q":
            call_stop(link, Role.WATCH, words, LEAVE)
            time.sleep(BEAT_S)  # the message must be sent before the token vanishes
            return 0
        if line:
            break
    states = request_all(link, Role.WATCH, CALL, words or Reason.WATCH_LOST.text, lambda: False)
    print("stopped: " + ", ".join(side.name.lower() for side in states))
    return 0
