"""Saying what has become of a side: to everyone on the link, and to whoever started the process."""

from teleop.link import Link
from teleop.messages import Event, text_bytes
from teleop.process import supervised
from teleop.session import Session
from teleop.topics import EVENT, Role


def tell(link: Link, role: Role, side: Session, text: str) -> None:
    """Publish `text` as an event; print it too, unless a launcher does."""
    link.publish(
        EVENT, Event(role=role, state=side.state, reason=side.reason, text=text_bytes(text))
    )
    if not supervised():
        print(f"{role.name.lower():9} {text}", flush=True)
