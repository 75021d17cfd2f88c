"""Events of a side, for all listeners on the link and for the terminal."""

import re

from teleop.link import Link
from teleop.messages.messages import Event, encode_text
from teleop.messages.topics import EVENT, Role
from teleop.runtime.process import is_supervised
from teleop.session.state_machine import SessionOutline

MARK = "mark"  # key of a request for an event of the user's words: "mark: trial 3 begins"

_PRESS = re.compile(r"button ([0-9]{1,9}) pressed")


def format_press(button: int) -> str:
    """Return the text of the event that a button of the device was pressed."""
    return f"button {button} pressed"


def parse_press(text: str) -> int | None:
    """Return the button of such an event, None of any other."""
    match = _PRESS.fullmatch(text)
    return None if match is None else int(match[1])


def publish_event(link: Link, role: Role, side: SessionOutline, text: str) -> None:
    """Publish `text` as an event; print it too, unless a launcher does."""
    link.publish(
        EVENT, Event(role=role, state=side.state, reason=side.reason, text=encode_text(text))
    )
    if not is_supervised():
        print(f"{role.name.lower():9} {text}", flush=True)
