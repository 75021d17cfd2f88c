"""Events of a side, for all listeners on the link and for the terminal."""

from teleop.link import Link
from teleop.messages.messages import Event, encode_text
from teleop.messages.topics import EVENT, Role
from teleop.runtime.process import is_supervised
from teleop.session.state_machine import SessionOutline

MARK = "mark"  # key of a request for an event of the user's words: "mark: trial 3 begins"


def publish_event(link: Link, role: Role, side: SessionOutline, text: str) -> None:
    """Publish `text` as an event; print it too, unless a launcher does."""
    link.publish(
        EVENT, Event(role=role, state=side.state, reason=side.reason, text=encode_text(text))
    )
    if not is_supervised():
        print(f"{role.name.lower():9} {text}", flush=True)
