"""Events of a side, for all listeners on the link and for the terminal."""

from teleop.link import Link
from teleop.messages import Event, text_bytes
from teleop.process import supervised
from teleop.session import SessionOutline
from teleop.topics import EVENT, Role


def publish_event(link: Link, role: Role, side: SessionOutline, text: str) -> None:
    """Publish `text` as an event; print it too, unless a launcher does."""
    link.publish(
        EVENT, Event(role=role, state=side.state, reason=side.reason, text=text_bytes(text))
    )
    if not supervised():
        print(f"{role.name.lower():9} {text}", flush=True)
