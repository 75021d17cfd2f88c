"""Change a setting of a running session.

  teleop set force.scale 0.3                 ramps to it in half a second
  teleop set operator.position_scale 0.1     finer motion; hand and tip do not jump
  teleop set operator.lock '[1]'             lock axis 1; '[]' unlocks it
  teleop set slave.rig.joints.0.environment.stiffness 800     of a simulated rig, in half a second

Of the environment of a simulated rig change stiffness, position, damping and dissipation, of one of
several parts as in slave.rig.joints.0.environment.parts.1.stiffness.

The side that has the setting answers with the new value or the reason of a refusal. The config file
is not changed.
"""

import argparse
import time

from teleop.config.options import add_option, add_options
from teleop.errors import TeleopError, UsageError
from teleop.link import Link, Listener
from teleop.messages.messages import TEXT_BYTES, Answer, Setting, decode_text, encode_text
from teleop.messages.topics import ANSWER, SETTING, Role
from teleop.remote.request_listener import find_side
from teleop.session.config import RunConfig, read_config
from teleop.session.running_sessions import describe_absence

ANSWER_TIMEOUT_S = 5.0
_POLL_S = 0.005


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `teleop set`."""
    parser.add_argument("key", metavar="KEY", help="e.g. force.scale; see above")
    parser.add_argument("value", metavar="VALUE", help="as in a config file")
    add_options(parser, "--session", "--config", "--insecure")
    add_option(
        parser,
        "--set",
        help="override a value of the config that selects the session (not the setting to change), "
        "e.g. --set session=bench",
    )


def main(args: argparse.Namespace) -> int:
    """Request the change from the side that has the setting; returns the exit code."""
    config = read_config(args).load(RunConfig)
    with Link(config.link, config.session, Role.REMOTE) as link:
        listener = link.listen((ANSWER,))
        await_side(link, config, find_side(args.key))
        print(request_setting(link, listener, args.key, args.value))
    return 0


def await_side(link: Link, config: RunConfig, side: Role) -> None:
    """Wait until the master or the slave of a session is connected; `TeleopError` if it is not."""
    deadline = time.monotonic() + ANSWER_TIMEOUT_S
    while not link.is_present(side):
        if time.monotonic() > deadline:
            name = side.name.lower()
            endpoints = config.link.routers or (getattr(config.link, name),)
            raise TeleopError(describe_absence(config.session, f"no {name} answers", endpoints))
        time.sleep(_POLL_S)


def request_setting(link: Link, listener: Listener, key: str, value: str) -> str:
    """Request a change from the side that has the setting; return its answer.

    `listener` is of `ANSWER` on this link, that of a supervisor; the "master." of a key may be left
    out. Raises `UsageError` if the side refuses, or key or value are too long; `TeleopError` if it
    does not answer.
    """
    for text in (key, value):
        if len(text.encode()) > TEXT_BYTES:
            raise UsageError(f"{text[:20]}...: longer than {TEXT_BYTES} bytes")
    key = key.removeprefix("master.")
    link.publish(SETTING, Setting(role=Role.REMOTE, key=encode_text(key), value=encode_text(value)))
    deadline = time.monotonic() + ANSWER_TIMEOUT_S
    while time.monotonic() < deadline:
        for item in listener.drain():
            answer = Answer.unpack(item.data)
            if answer.asker == link.nonce:
                text = decode_text(answer.text)
                if not answer.accepted:
                    raise UsageError(text)
                return text
        time.sleep(_POLL_S)
    side = find_side(key).name.lower()
    raise TeleopError(f"the {side} did not answer within {ANSWER_TIMEOUT_S:g} s")
