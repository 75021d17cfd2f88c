"""Publisher of the energy ledger of one side."""

from typing import Any

from estimator.records import StructArray
from teleop.messages.messages import Ledger
from teleop.messages.packet import Packet
from teleop.messages.topics import Role

LEDGER_PERIOD_NS = 10_000_000  # between two messages
_FIELDS = ("credit", "put_in", "taken_out", "passed_on", "received", "dissipated", "granted")


class LedgerPublisher:
    """Fills in the message about the ledger of one side, every `LEDGER_PERIOD_NS`.

    Parameters
    ----------
    role : Role
        Whose ledger it is.
    sides : Records
        `Side`, shape (1,), of a loop.
    joints : int
        Number of its ports in use.
    """

    def __init__(self, role: Role, sides: StructArray, joints: int) -> None:
        self._packet = Packet(Ledger)
        self._fields: Any = self._packet.records
        self._fields["role"], self._fields["joints"] = role, joints
        self._ports, self._joints = sides["ports"], joints
        self._due_ns = 0

    def is_due(self, stamp_ns: int) -> bool:
        """Return whether a message is due at `stamp_ns` [ns]; the next is then a period later."""
        if stamp_ns < self._due_ns:
            return False
        self._due_ns = stamp_ns + LEDGER_PERIOD_NS
        return True

    def filled(self) -> Packet[Ledger]:
        """Return the message with the present ledger."""
        for name in _FIELDS:
            self._fields[name][:, : self._joints] = self._ports[name][:, : self._joints]
        return self._packet
