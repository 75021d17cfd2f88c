"""Records for tests of the master: of messages, hands and arrays of eight."""

from typing import Any

import numpy as np

from estimator.structs import view_struct
from master.hand_input import HandInput, fill_axes, fill_hand_input
from teleop.messages.messages import MAX_JOINTS, Message


def message_records(cls: type[Message]) -> Any:
    """Return an array of one blank record with the fields of a message class."""
    wires = cls.schema.wires.items()
    fields = [(n, (w.numpy, (w.count,)) if w.count > 1 else w.numpy) for n, w in wires]
    return np.zeros(1, np.dtype(fields, align=True))


def message_record(message: Message) -> Any:
    return view_struct(to_message_records(message))


def to_message_records(message: Message) -> Any:
    records = message_records(type(message))
    for name in records.dtype.names:
        records[name] = getattr(message, name)
    return records


def hand_record(hand: Any) -> Any:
    records = HandInput.array()
    fill_hand_input(records, hand)
    return view_struct(records)


def eight(*values: float) -> Any:
    """Return an array of `MAX_JOINTS` numbers that begins with `values`."""
    array = np.empty(MAX_JOINTS)
    fill_axes(array, values)
    return array
