"""Events as a text log, and the sides' states as coloured lanes over time."""

import numpy as np
import rerun as rr

from teleop.messages.messages import STOP_ACTIONS, decode_text
from teleop.messages.topics import ANSWER, EVENT, SETTING, STOP, Role, format_role
from teleop.session.state_machine import State
from teleop.view.batch import AnyTopic, Rows
from teleop.view.colours import STATES
from teleop.view.sender import Sender

LOGGED_TOPICS: tuple[AnyTopic, ...] = (EVENT, STOP, SETTING, ANSWER)
_REPEAT_NS = 10_000_000_000  # [ns] a state is repeated, for views of the recent past
_LEVELS = {"fault": "ERROR", "stopped": "CRITICAL", "holding": "WARN"}


def log_rows(sender: Sender, topic: AnyTopic, rows: Rows) -> None:
    """Send text messages."""
    texts = [_format_message(topic, row) for row in rows]
    columns = rr.TextLog.columns(
        text=[
            f"{format_time_of_day(row)}  {text}" for row, (text, _) in zip(rows, texts, strict=True)
        ],
        level=[level for _, level in texts],
    )
    sender.columns("log", rows, columns)


def format_time_of_day(row: np.void) -> str:
    """Return the time of day at which a message was sent, UTC."""
    moment = np.datetime64(int(row["stamp_ns"]), "ns").astype("datetime64[ms]")
    return str(moment).split("T")[1]


def _format_message(topic: AnyTopic, row: np.void) -> tuple[str, str]:
    """Return the line of one message, and its level."""
    if topic is STOP:
        action = int(row["action"])
        word = STOP_ACTIONS[action] if action < len(STOP_ACTIONS) else f"action {action}"
        level = "CRITICAL" if word == "stop" else "INFO"
        return f"{format_role(int(row['role']))}: {word}: {decode_text(tuple(row['text']))}", level
    if topic is SETTING:
        return f"set {decode_text(tuple(row['key']))} = {decode_text(tuple(row['value']))}", "INFO"
    text = f"{format_role(int(row['role']))}: {decode_text(tuple(row['text']))}"
    if topic is ANSWER:
        return text, "INFO" if row["accepted"] else "WARN"
    return text, _LEVELS.get(format_state(int(row["state"])), "INFO")


def format_state(number: int) -> str:
    """Return the name of a session's state in small letters."""
    return State(number).name.lower()


class StateLanes:
    """Draws the state of each side under `state/<role>`, on changes and periodically."""

    def __init__(self, sender: Sender) -> None:
        self._sender = sender
        self._shown: dict[Role, tuple[int, int]] = {}  # role -> state, stamp [ns] of the last row

    def draw(self, role: Role, rows: Rows) -> None:
        """Draw the states in messages of one side, every one of them."""
        if len(rows) == 0:
            return
        state, said_ns = self._shown.get(role, (-1, 0))
        states = rows["state"].astype(np.int64)
        changed = np.diff(states, prepend=state) != 0
        keep = np.flatnonzero(changed)
        if len(keep) == 0 and int(rows["stamp_ns"][-1]) - said_ns > _REPEAT_NS:
            keep = np.array([len(rows) - 1])
        if len(keep) == 0:
            return
        self._shown[role] = int(states[keep[-1]]), int(rows["stamp_ns"][keep[-1]])
        path = f"state/{format_role(role)}"
        style = rr.StateConfiguration(values=list(STATES), colors=list(STATES.values()))
        self._sender.once(path, style)
        names = [format_state(int(number)) for number in states[keep]]
        self._sender.columns(path, rows[keep], rr.StateChange.columns(state=names))
